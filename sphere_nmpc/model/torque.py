# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motor torques of a plan, and the rotor acceleration that a torque limit allows (Eqs. 44 to 46).

The torque of a motor is the inertia of its rotor times the acceleration of the rotor in space:

    tau_i = I1 (du_i/dt + domega_i/dt).

Without momentum the angular velocity of the shell in the body frame is, by Eq. 11 over It1 + m,

    A omega = -c1 [u, 0],   A = diag(1, 1, r1 / r3) - r1 k k^T,   dk/dt = k x omega,

and the derivative of that, in which k x omega is perpendicular to omega,

    A domega/dt = -c1 [du/dt, 0] + r1 (k . omega) dk/dt.

Its last term is the torque at constant rotor speeds while the shell rotates. The maxima of both
parts over all orientations are computed once, so that a torque limit becomes an acceleration limit
that is valid everywhere: with W = -c1 A^-1, |u_i| <= u_max and |du_i/dt| <= a,

    |tau_i| <= I1 (s a + w),   s = max_k sum_j |1_ij + W_ij|,   w = max_{k, u} |domega_i/dt|,

the last one at constant speeds.
"""

from dataclasses import replace
from functools import cache

import numpy as np

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, QUATERNION, Vector

_DIRECTIONS = 500
"""Directions of the vertical in the search; the maxima are flat, 400 give them within 1 %."""
_MARGIN = 1.01
"""Factor on the largest values found."""
_SPEEDS_ON_EDGE = 21
"""Rotor speeds in the search on each edge of the square |u_i| <= u_max."""


def torques(
    states: Vector, hold: FirstOrderHold, constants: LumpedConstants, rotor_axial_inertia: float
) -> tuple[Vector, Vector]:
    """Return the motor torques along a plan of K knots, just after and just before them.

    `states`, shape (K, 6), are those at the knots. The torques are at the start and at the end of
    each interval [N m], shape (K - 1, 2); in between they are nearly linear in time.
    """
    slopes = np.diff(hold.speeds, axis=0) / hold.durations[:, None]
    verticals, p = rotation.vertical(states[:, QUATERNION]), constants.as_array()
    after = rotor_acceleration(verticals[:-1], hold.speeds[:-1], slopes, p)
    before = rotor_acceleration(verticals[1:], hold.speeds[1:], slopes, p)
    return rotor_axial_inertia * after, rotor_axial_inertia * before


def heat_and_energy(durations: Vector, speeds: Vector, after: Vector, before: Vector) -> Vector:
    """Return the integrals of torque squared [N^2 m^2 s] and of |torque times speed| [J], (2,).

    Both are summed over the rotors. In intervals of `durations` [s], shape (K,), their speeds
    relative to the shell, (K + 1, 2), are linear, and so are the torques from just `after` the
    start to just `before` the end, (K, 2). Both are nan without an interval.
    """
    if not durations.size:
        return np.full(2, np.nan)
    squares = np.sum(after * after + after * before + before * before, axis=1)
    powers = np.sum(np.abs(after * speeds[:-1]) + np.abs(before * speeds[1:]), axis=1)
    return np.array((durations @ squares / 3.0, durations @ powers / 2.0))


def largest_acceleration(robot: RobotParameters) -> float:
    """Return the rotor acceleration [rad/s^2] that respects the torque limit in all orientations.

    At most `max_rotor_acceleration`, which is also the result without a torque limit. A limit that
    is too low even for constant largest speeds while the shell rotates is refused.
    """
    if robot.max_rotor_torque <= 0.0:
        return robot.max_rotor_acceleration
    inertia = robot.rotor_axial_inertia
    share, turning = _worst(*robot.lumped.as_array()[1:])
    at_speed = turning * robot.max_rotor_speed**2
    left = (robot.max_rotor_torque / inertia - at_speed) / share
    if left < 1.0:
        raise InvalidParameterError(
            "max_rotor_torque", robot.max_rotor_torque,
            f"0 or more than {inertia * (at_speed + share):.3g} N m, the torque at "
            f"{robot.max_rotor_speed:g} rad/s while the shell rotates",
        )
    return min(robot.max_rotor_acceleration, left)


def within_torque(robot: RobotParameters) -> RobotParameters:
    """Return the robot with the acceleration limit that its torque limit allows."""
    return replace(robot, max_rotor_acceleration=largest_acceleration(robot))


@cache
def _worst(input_gain: float, transverse_ratio: float, axial_ratio: float) -> tuple[float, float]:
    """Return s [-] and w / u_max^2 [-] of the bound in the module's docstring."""
    p = np.array([1.0, input_gain, transverse_ratio, axial_ratio])
    verticals = _directions(_DIRECTIONS)
    still = np.zeros((_DIRECTIONS, INPUT_SIZE))
    gains = [np.abs(rotor_acceleration(verticals, still, still + du, p)) for du in np.eye(2)]
    along = np.linspace(-1.0, 1.0, _SPEEDS_ON_EDGE)
    # Quadratic in the speeds, it is largest on the edges of the square; opposite edges agree.
    edges = np.vstack([np.column_stack((np.ones(_SPEEDS_ON_EDGE), along)),
                       np.column_stack((along, np.ones(_SPEEDS_ON_EDGE)))])
    turning = [np.abs(rotor_acceleration(verticals, still + u, still, p)).max() for u in edges]
    return _MARGIN * float(np.max(sum(gains))), _MARGIN * float(np.max(turning))


def rotor_acceleration(verticals: Vector, u: Vector, du: Vector, constants: Vector) -> Vector:
    """Return accelerations of the rotors in space [rad/s^2], shape (K, 2).

    They are the motor torques over I1 (Eq. 45, with the exact derivative for Eq. 46).

    Parameters
    ----------
    verticals : ndarray, shape (K, 3)
        World's vertical k [-; body frame].
    u, du : ndarray, shape (K, 2)
        Speeds and accelerations of the rotors relative to the shell [rad/s, rad/s^2].
    constants : ndarray, shape (4,)
        Lumped constants [Rs, c1, r1, r3].
    """
    _, c1, r1, r3 = constants
    inertia = np.diag((1.0, 1.0, r1 / r3)) - r1 * verticals[:, :, None] * verticals[:, None, :]

    def solved(speeds: Vector, torque: Vector) -> Vector:
        torque[:, :INPUT_SIZE] -= c1 * speeds
        solution: Vector = np.linalg.solve(inertia, torque[:, :, None])[:, :, 0]
        return solution

    rate = solved(u, np.zeros((len(u), 3)))
    along = np.sum(verticals * rate, axis=1, keepdims=True)
    shell = solved(du, r1 * along * np.cross(verticals, rate))
    return shell[:, :INPUT_SIZE] + du


def _directions(number: int) -> Vector:
    """Return directions, shape (number, 3), that are spread evenly over the sphere."""
    height = 1.0 - (2.0 * np.arange(number) + 1.0) / number
    angle, flat = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(number), np.sqrt(1.0 - height**2)
    return np.column_stack((flat * np.cos(angle), flat * np.sin(angle), height))
