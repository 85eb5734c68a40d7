# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Error state of a configuration and its propagation along the motion.

An error is [dx, dy, a1, a2, a3], shape (5,): a displacement [m; world frame] and a rotation vector
[rad; body frame] that is applied after the orientation, q exp(a / 2). It has one number for each
degree of freedom and, unlike the four components of a quaternion, no constraint.
"""

from functools import cache

import casadi as ca
import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.dynamics import body_rate, rolling_velocity
from sphere_nmpc.model.integrator import DEFAULT_MAX_STEP, cf4_step, steps_for
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_nmpc.model.symbolic_rotation import quaternion_product, rotation_matrix

ERROR_SIZE = 5


def apply_error(state: Vector, error: Vector) -> Vector:
    """Return the state, shape (6,), changed by an error, shape (5,)."""
    q = rotation.product(state[QUATERNION], rotation.exponential(error[2:]))
    return np.concatenate((state[POSITION] + error[:2], q / np.linalg.norm(q)))


def error_between(state: Vector, other: Vector) -> Vector:
    """Return the error, shape (5,), that leads from `state` to `other`, both shape (6,)."""
    turn = rotation.product(rotation.conjugate(state[QUATERNION]), other[QUATERNION])
    return np.concatenate((other[POSITION] - state[POSITION], rotation.logarithm(turn)))


def state_rates(state: Vector, speeds: Vector, constants: Vector) -> Vector:
    """Return velocity [m/s; world frame] and angular velocity [rad/s; body frame], shape (5,).

    Parameters
    ----------
    state : ndarray, shape (6,)
    speeds : ndarray, shape (2,)
        Rotor speeds [rad/s].
    constants : ndarray, shape (4,)
        Lumped constants [Rs, c1, r1, r3].
    """
    return np.array(_rates()(state, speeds, constants)).ravel()


def propagate(
    state: Vector,
    speeds: tuple[Vector, Vector],
    duration: float,
    constants: Vector,
    max_step: float = DEFAULT_MAX_STEP,
) -> tuple[Vector, Vector, Vector]:
    """Advance over an interval of a first-order hold, with the derivatives of the result.

    Parameters
    ----------
    state : ndarray, shape (6,)
        State at the start.
    speeds : tuple of ndarray, each of shape (2,)
        Rotor speeds at both ends [rad/s].
    duration : float
        Length of the interval [s].
    constants : ndarray, shape (4,)
        Lumped constants [Rs, c1, r1, r3].
    max_step : float, optional
        Longest integration step [s].

    Returns
    -------
    state : ndarray, shape (6,)
        State at the end.
    by_state : ndarray, shape (5, 5)
        Derivative of the error at the end by the error at the start.
    by_constants : ndarray, shape (5, 4)
        Derivative of the error at the end by the constants.
    """
    steps = steps_for(duration, max_step)
    start, change = speeds[0], speeds[1] - speeds[0]
    by_state: Vector = np.eye(ERROR_SIZE)
    by_constants: Vector = np.zeros((ERROR_SIZE, 4))
    for i in range(steps):
        here, there = start + change * (i / steps), start + change * ((i + 1) / steps)
        found = _propagation_step()(state, here, there, duration / steps, constants)
        end, onwards, added = (np.array(matrix, dtype=float) for matrix in found)
        state = end.ravel()
        by_state, by_constants = onwards @ by_state, onwards @ by_constants + added
    return state, by_state, by_constants


@cache
def _propagation_step() -> ca.Function:
    x, p, d = ca.SX.sym("x", 6), ca.SX.sym("p", 4), ca.SX.sym("d", ERROR_SIZE)
    u_start, u_end, h = ca.SX.sym("u_start", 2), ca.SX.sym("u_end", 2), ca.SX.sym("h")
    shift, q = cf4_step(x[2:6], u_start, u_end, h, p)
    # To first order, which suffices for the derivative at zero.
    turned = quaternion_product(x[2:6], ca.vertcat(1.0, 0.5 * d[2:5]))
    moved, turned_end = cf4_step(turned, u_start, u_end, h, p)
    inverse = ca.vertcat(q[0], -q[1:4])
    held = ca.SX.sym("q", 4)
    away = ca.vertcat(d[0:2] + moved, 2.0 * quaternion_product(held, turned_end)[1:4])
    by_state = ca.substitute(ca.jacobian(away, d), held, inverse)
    by_constants = ca.substitute(ca.jacobian(away, p), held, inverse)
    zero = ca.SX.zeros(ERROR_SIZE)
    outputs = [
        ca.vertcat(x[0:2] + shift, q),
        ca.substitute(by_state, d, zero),
        ca.substitute(by_constants, d, zero),
    ]
    return ca.Function("propagation_step", [x, u_start, u_end, h, p], outputs)


@cache
def _rates() -> ca.Function:
    x, u, p = ca.SX.sym("x", 6), ca.SX.sym("u", 2), ca.SX.sym("p", 4)
    body = body_rate(x[2:6], u, p)
    velocity = rolling_velocity(ca.mtimes(rotation_matrix(x[2:6]), body), p[0])
    return ca.Function("rates", [x, u, p], [ca.vertcat(velocity, body)])
