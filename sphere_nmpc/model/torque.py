# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motor torques of a plan, and the rotor acceleration that a torque limit allows (Eqs. 44 to 46).

The torque of a motor is the inertia of its rotor times the acceleration of the rotor in space:

    tau_i = I1 (du_i/dt + domega_i/dt).

Without momentum the angular velocity of the shell in the body frame is, by Eq. 11 over It1 + m,

    A omega = -c1 [u, 0],   A = diag(1, 1, r1 / r3) - r1 k k^T,   dk/dt = k x omega,

and the derivative of that, in which k x omega is perpendicular to omega,

    A domega/dt = -c1 [du/dt, 0] + r1 (k . omega) dk/dt.

Its last term is the torque at constant rotor speeds while the shell rotates. With the inverse of A
by Sherman and Morrison, k_h = (k_x, k_y) and N = 1 - r1 |k_h|^2 - r3 k_z^2,

    domega/dt = -c1 (du/dt + r1 (k_h . du/dt) k_h / N)
                + r1 (1 - r3) c1^2 (k_h . u) k_z (-u_2, u_1) / N^2.

The largest values of both parts over all orientations make a torque limit an acceleration limit
that is valid everywhere: with |u_i| <= u_max and |du_i/dt| <= a,

    |tau_i| <= I1 (s a + w u_max^2).

The first part is largest where |k_x k_y| - k_i^2 is, (sqrt(2) - 1) / 2 of |k_h|^2, with k level.
The second one is it where g(x) = sqrt(x) (1 + x) / (1 - r1 + (1 - r3) x)^2 of x = (k_z / |k_h|)^2
is, at the positive root of (1 - r3) x^2 - 3 (r3 - r1) x = 1 - r1.
"""

import math
from dataclasses import replace

import numpy as np

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector


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
    share, turning = largest_shares(robot.lumped.as_array())
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


def largest_shares(constants: Vector) -> tuple[float, float]:
    """Return s [-] and w [-] of the bound in the module's docstring."""
    _, c1, r1, r3 = constants.tolist()
    level, upright = 1.0 - r1, 1.0 - r3
    half = 1.5 * (upright - level)
    x = (math.sqrt(half**2 + level * upright) - half) / upright
    turning = math.sqrt(2.0 * x) * (1.0 + x) / (level + upright * x) ** 2
    return (
        1.0 - c1 + c1 * r1 * (math.sqrt(2.0) - 1.0) / (2.0 * level),
        r1 * upright * c1**2 * turning,
    )


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
    level, left = _level(verticals, constants)
    along, change = (np.sum(level * v, axis=1, keepdims=True) / left for v in (u, du))
    turning = along * verticals[:, 2:] / left * u[:, ::-1] * (-1.0, 1.0)
    accelerations: Vector = du - c1 * (du + r1 * change * level)
    return accelerations + r1 * (1.0 - r3) * c1**2 * turning


def attainable(
    limit: float, verticals: Vector, u: Vector, du: Vector, constants: Vector
) -> tuple[Vector, Vector]:
    """Return the least and the largest du/dt of each rotor, with that of the other one.

    Both have the shape (2, K); the acceleration in space is within `limit` [rad/s^2]. The other
    parameters are those of `rotor_acceleration`.
    """
    level, left = _level(verticals, constants)
    own = 1.0 - constants[1] * (1.0 + constants[2] * level**2 / left)
    others = rotor_acceleration(verticals, u, du, constants) - own * du
    return ((-limit - others) / own).T, ((limit - others) / own).T


def _level(verticals: Vector, constants: Vector) -> tuple[Vector, Vector]:
    """Return k_h, shape (K, 2), and N, (K, 1), of the module's docstring."""
    squares = verticals**2 @ constants[[2, 2, 3]]
    return verticals[:, :2], 1.0 - squares[:, None]
