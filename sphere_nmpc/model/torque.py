# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motor torques of a plan, and the rotor acceleration that a torque limit allows (Eqs. 44 to 46).

The torque of a motor is the inertia of its rotor times the acceleration of the rotor in space:

    tau_i = I1 (du_i/dt + domega_i/dt),   omega = W(k) u,   domega/dt = W du/dt + (dW/dt) u.

The last term is the torque at constant rotor speeds while the shell rotates. The maxima of both
parts over all orientations are computed once, so that a torque limit becomes an acceleration limit
that is valid everywhere: with |u_i| <= u_max and |du_i/dt| <= a,

    |tau_i| <= I1 (s a + w),   s = max_k sum_j |1_ij + W_ij|,   w = max_{k, u} |(dW/dt u)_i|.
"""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.dynamics import world_rate
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, QUATERNION, Vector
from sphere_nmpc.model.symbolic_rotation import Expression, quaternion_product, rotation_matrix

_ORIENTATIONS = 500
"""Directions of the vertical in the search; the maxima are flat, 400 give them within 1 %."""
_MARGIN = 1.01
"""Factor on the largest values found."""
_EDGE = 21
"""Rotor speeds in the search on each edge of the square |u_i| <= u_max."""


def torques(
    states: Vector, hold: FirstOrderHold, constants: LumpedConstants, rotor_axial_inertia: float
) -> tuple[Vector, Vector]:
    """Return the motor torques along a plan of K knots, just after and just before them.

    `states`, shape (K, 6), are those at the knots. The torques are at the start and at the end of
    each interval [N m], shape (K - 1, 2); in between they are nearly linear in time.
    """
    slopes = np.diff(hold.speeds, axis=0) / np.diff(hold.times)[:, None]
    turns, p = states[:, QUATERNION], constants.as_array()
    after = _accelerations(turns[:-1], hold.speeds[:-1], slopes, p)
    before = _accelerations(turns[1:], hold.speeds[1:], slopes, p)
    return rotor_axial_inertia * after, rotor_axial_inertia * before


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
    turns = _turns(_ORIENTATIONS)
    rates = ca.SX.sym("q", 4), ca.SX.sym("u", 2)
    gain = ca.jacobian(_body_rate(*rates, ca.DM(p))[0:2], rates[1]) + ca.SX.eye(INPUT_SIZE)
    gains = ca.Function("gain", [rates[0]], [gain]).map(len(turns))
    sums = np.abs(np.array(gains(turns.T)).reshape(INPUT_SIZE, len(turns), INPUT_SIZE)).sum(axis=2)
    along = np.linspace(-1.0, 1.0, _EDGE)
    # Quadratic in the speeds, it is largest on the edges of the square; opposite edges agree.
    edges = np.vstack([np.column_stack((np.ones(_EDGE), along)),
                       np.column_stack((along, np.ones(_EDGE)))])
    still = np.zeros((len(turns), INPUT_SIZE))
    turning = max(np.max(np.abs(_accelerations(turns, still + u, still, p))) for u in edges)
    return _MARGIN * float(np.max(sums)), _MARGIN * float(turning)


def _accelerations(turns: Vector, speeds: Vector, slopes: Vector, constants: Vector) -> Vector:
    """Return rotor accelerations in space [rad/s^2], shape (K, 2)."""
    if not len(turns):
        return np.zeros((0, INPUT_SIZE))
    batch = rotor_acceleration().map(len(turns))
    found: Vector = np.array(
        batch(turns.T, speeds.T, slopes.T, np.tile(constants[:, None], len(turns)))
    ).T
    return found


@cache
def rotor_acceleration() -> ca.Function:
    """Return (q, u, du, p) -> acceleration of the rotors in space [rad/s^2], shape (2,).

    It is the motor torque over I1 (Eq. 45, with the exact derivative for Eq. 46). q is the unit
    quaternion wxyz, u and du are speeds and accelerations of the rotors relative to the shell
    [rad/s, rad/s^2], p the lumped constants [Rs, c1, r1, r3].
    """
    q, u, du, p = (ca.SX.sym(name, size) for name, size in zip("qudp", (4, 2, 2, 4), strict=True))
    rate = _body_rate(q, u, p)
    turn_rate = 0.5 * quaternion_product(q, ca.vertcat(0, rate))
    shell = ca.jtimes(rate, q, turn_rate) + ca.jtimes(rate, u, du)
    return ca.Function("rotor_acceleration", [q, u, du, p], [shell[0:2] + du])


def _body_rate(q: Expression, u: Expression, p: Expression) -> Expression:
    """Return the angular velocity of the shell without momentum [rad/s; body frame], (3,)."""
    return ca.mtimes(
        rotation_matrix(q).T, world_rate(q, ca.DM.zeros(3), u, p, ca.DM.zeros(3))
    )


def _turns(number: int) -> Vector:
    """Return orientations, shape (number, 4), with verticals spread evenly over the sphere."""
    height = 1.0 - (2.0 * np.arange(number) + 1.0) / number
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(number)
    # The rotation that takes the direction to the vertical is about their cross product.
    flat = np.sqrt(1.0 - height**2)
    vertical = np.column_stack((flat * np.cos(angle), flat * np.sin(angle), height))
    turns = np.column_stack((1.0 + height, vertical[:, 1], -vertical[:, 0], np.zeros(number)))
    return turns / np.linalg.norm(turns, axis=1)[:, None]
