# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Layout and geometry of the state ``x = [x, y, q1, q2, q3, q4, h1, h2, h3]`` and of poses.

Position of the sphere's centre in the plane [m; world frame], then the unit quaternion **wxyz**
(scalar first) that takes body vectors to world ones, and the momentum h [rad/s; world frame] of
`sphere_nmpc.model.disturbance`. Goals and measurements are poses, a state's first six numbers.
Every slice of a state is named here.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.rotation import NORM_TOLERANCE, Vector

POSE_NAMES = ("x", "y", "q1", "q2", "q3", "q4")
INPUT_SIZE = 2
POSITION = slice(0, 2)
QUATERNION = slice(2, 6)
POSE = slice(0, 6)
MOMENTUM = slice(6, 9)
POSE_SIZE, STATE_SIZE = POSE.stop, MOMENTUM.stop

NO_MOMENTUM: Vector = np.zeros(3)
NO_MOMENTUM.flags.writeable = False

DEFAULT_START = 2.0, -3.0, 0.03, 0.454, 0.88, 0.1363
"""Pose at which simulator and odometry begin where none is given: that of case 1 of the paper."""
FARTHEST = 1e6
"""Largest coordinate of a position [m]; far beyond it sums and squares lose what is near."""


def make_state(position: ArrayLike, quaternion_wxyz: ArrayLike) -> Vector:
    """Build a state from its parts, normalising the quaternion.

    `InvalidStateError` is raised if a part has the wrong length, is not finite or too far away, or
    the norm of the quaternion is not within `NORM_TOLERANCE` of 1.
    """
    place = np.asarray(position, dtype=float)
    turn = np.asarray(quaternion_wxyz, dtype=float)
    if place.shape != (2,) or turn.shape != (4,):
        raise InvalidStateError(
            "state", (place.shape, turn.shape),
            "the shapes of a position, (2,) [m], and of a quaternion wxyz, (4,)",
        )
    # On six numbers Python is faster than NumPy, and this runs for every measured pose.
    numbers: list[float] = np.concatenate((place, turn)).tolist()
    if not all(map(math.isfinite, numbers)):
        raise InvalidStateError(
            "state", numbers, "finite numbers [x, y, qw, qx, qy, qz] [m, -]"
        )
    if max(abs(numbers[0]), abs(numbers[1])) > FARTHEST:
        raise InvalidStateError(
            "position", numbers[:2], f"at most {FARTHEST:g} m from the origin along each axis"
        )
    norm = math.sqrt(turn.dot(turn))
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise InvalidStateError(
            "quaternion", numbers[2:], f"norm 1 within {NORM_TOLERANCE:g}, not norm {norm:.6g}"
        )
    return np.concatenate((place, turn / norm))


def without_momentum(pose: Vector) -> Vector:
    """Return the state, shape (9,), of a pose, or of another state, without momentum."""
    return np.concatenate((pose[POSE], NO_MOMENTUM))


def as_state(values: ArrayLike) -> Vector:
    """Check and normalise a flat state [x, y, qw, qx, qy, qz], shape (6,); see `make_state`."""
    try:
        flat = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InvalidStateError("state", values, "numbers [x, y, qw, qx, qy, qz]") from None
    if flat.shape != (POSE_SIZE,):
        raise InvalidStateError("state", flat.shape, f"the shape ({POSE_SIZE},)")
    return make_state(flat[POSITION], flat[QUATERNION])


def upright_state(x: float, y: float, yaw: float = 0.0) -> Vector:
    """Return the state, shape (6,), of an upright sphere at x, y [m] with a heading [rad]."""
    return make_state((x, y), (math.cos(yaw / 2.0), 0.0, 0.0, math.sin(yaw / 2.0)))


def are_states(rows: Vector) -> NDArray[np.bool_]:
    """Return which rows, shape (n, 6), `as_state` accepts, shape (n,)."""
    near = np.all(np.abs(rows[:, POSITION]) <= FARTHEST, axis=1)  # False for nan
    accepted: NDArray[np.bool_] = near & rotation.is_unit(rows[:, QUATERNION])
    return accepted


def nearer_sign(goal: Vector, state: Vector) -> Vector:
    """Return `goal` with the sign of its quaternion that is nearer to that of `state`."""
    signed = goal.copy()
    if float(goal[QUATERNION] @ state[QUATERNION]) < 0.0:
        signed[QUATERNION] *= -1.0
    return signed


_OTHER_SIGN = np.array([1.0, 1.0, -1.0, -1.0, -1.0, -1.0])


def flipped_sign(goal: Vector) -> Vector:
    """Return the same goal with the other of its two quaternions."""
    return goal * _OTHER_SIGN


def state_error(state: Vector, goal: Vector) -> float:
    """Return ||x - x_d|| in R^6 with the goal's quaternion sign that is nearer [mixed units]."""
    difference = state[POSE] - nearer_sign(goal, state)
    return math.sqrt(difference.dot(difference))


def position_error(state: Vector, goal: Vector) -> float:
    """Return the distance between the two centres [m]."""
    return float(np.linalg.norm(state[POSITION] - goal[POSITION]))


def angle_error(state: Vector, goal: Vector) -> float:
    """Return the angle of the rotation between the two orientations [rad], 0 to pi."""
    return float(rotation.angle_between(state[QUATERNION], goal[QUATERNION]))


def contact_points(states: Vector, shell_radius: float) -> Vector:
    """Return the contact points on the shell [m; body frame], shape (..., 3) (Eq. 18).

    `states`, shape (..., 6) or (..., 9), is one pose or state, or one a row; the radius is in m.
    """
    return -shell_radius * rotation.vertical(states[..., QUATERNION])
