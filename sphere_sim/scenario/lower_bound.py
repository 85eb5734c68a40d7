# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Lower bound of the time between two states of rest, without drift; proof: docs/time_bound.md.

With rotor speeds u the sphere rolls at v and rotates at omega, omega_k of it about the vertical,
such that everywhere ``c1^2 |u|^2 = (v / Rs)^2 + mu(k) omega_k^2`` with mu(k) > 0. So the least
integral of |u| follows from the distance and the angle of the rotation, and the least time from
that integral and the limits of speed, acceleration and torque.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from sphere_nmpc.model import rotation
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector, angle_error, position_error

_CELLS = 1000
"""Intervals of the latitude; more of them raise the bound, by less than 1 ms from 1000 on."""


def lower_bound(start: Vector, goal: Vector, robot: RobotParameters) -> float:
    """Return a time [s] in which no motion leads from rest at the start to rest at the goal.

    Both have shape (6,); the sphere has no momentum, and the floor is level.
    """
    constants = robot.lumped
    turn = angle_error(start, goal)
    first, last = (rotation.vertical(state[QUATERNION]) for state in (start, goal))
    rolled = max(
        position_error(start, goal) / constants.shell_radius,
        rotation.between(first, last),
    )
    least = max(
        float(_least_input(rolled, turn, _least_share(constants))),
        _by_latitude(float(first[2]), float(last[2]), turn, constants),
    )
    # From rest to rest, Eq. (8): the time at full speed, and that of a ramp to full speed.
    speed = robot.max_rotor_speed
    at_full_speed = least / (constants.input_gain * math.sqrt(2.0) * speed)
    ramp = speed / _largest_gain(robot)
    return at_full_speed + ramp if at_full_speed >= ramp else 2.0 * math.sqrt(at_full_speed * ramp)


def _largest_gain(robot: RobotParameters) -> float:
    """Return a' [rad/s^2] with ``|u(t)| <= sqrt(2) a' t`` from rest, Eq. (7) of the document.

    A torque limit bounds the speeds of the rotors in space, of which those against the shell are
    a multiple that the orientation limits. For a while they may accelerate faster than this.
    """
    if robot.max_rotor_torque <= 0.0:
        return robot.max_rotor_acceleration
    least_share = 1.0 - robot.rotor_axial_inertia / robot.transverse_inertia
    by_torque = robot.max_rotor_torque / (robot.rotor_axial_inertia * least_share)
    return min(robot.max_rotor_acceleration, by_torque)


def _least_input(rolled: ArrayLike, turn: float, share: ArrayLike) -> Vector:
    """Return the least c1 times the integral of |u| [rad], Eq. (4) of the document.

    It follows from the least integrals of the rate of rolling and of the whole angular velocity
    (`turn`) [rad], and from the square of the least c1 |u| for 1 rad/s about the vertical [-].
    """
    rolled, share = np.asarray(rolled), np.asarray(share)
    least: Vector = np.hypot(
        np.sqrt(1.0 - share) * rolled, np.sqrt(share) * np.maximum(rolled, turn)
    )
    return least


def _least_share(constants: LumpedConstants) -> float:
    """Return mu [-], the least of mu(k) over all orientations."""
    r1, r3 = constants.transverse_ratio, constants.axial_ratio
    return (1.0 - r1) ** 2 - (r1 - r3) ** 2


def _by_latitude(first: float, last: float, turn: float, constants: LumpedConstants) -> float:
    """Return the least c1 times the integral of |u| [rad], Eq. (6) of the document.

    `first` and `last` are the sines of the latitude of the contact point on the shell at start and
    goal, `turn` is the angle between the two orientations [rad].
    """
    ends = np.abs(np.arcsin(np.clip([first, last], -1.0, 1.0)))
    nearest = float(np.min(ends)) if first * last > 0.0 else 0.0
    edges = np.linspace(0.0, nearest, _CELLS + 1)
    # Within a cell: the way to its far edge, and the share at its near one, both the least.
    way = np.sum(ends) - 2.0 * edges[1:]
    return float(np.min(_least_input(way, turn, _least_share_from(edges[:-1], constants))))


def _least_share_from(latitude: ArrayLike, constants: LumpedConstants) -> Vector:
    """Return eta [-], shape (n,), the least at any higher latitude [rad], Eq. (5) of the document.

    It is the square of the least c1 |u| for a rotation of 1 rad/s at a constant latitude.
    """
    r1, r3 = constants.transverse_ratio, constants.axial_ratio
    tilt = ((1.0 - r3) * np.tan(latitude)) ** 2
    limit = 1.0 - ((r1 - r3) / (1.0 - r3)) ** 2
    share: Vector = np.minimum(((1.0 - r1) ** 2 + limit * tilt) / (1.0 + tilt), limit)
    return np.maximum(share, _least_share(constants))
