# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Integration of the motion under a first-order hold on the rotation group.

A commutator-free Lie group method of order four (CF4 of Celledoni, Marthinsen and Owren, 2003)
composes exponentials of body rates, so the quaternion keeps its unit norm to rounding, and at the
robot's speeds one step is as accurate as about three of the classical Runge-Kutta method.
"""

import math
from collections.abc import Callable, Iterator
from functools import cache

import casadi as ca
import numpy as np

from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.dynamics import (
    body_rate,
    momentum_rate,
    rolling_velocity,
    world_rate_with_momentum,
)
from sphere_nmpc.model.state import Vector
from sphere_nmpc.model.symbolic_rotation import (
    Expression,
    quaternion_exponential,
    quaternion_product,
    rotation_matrix,
)

DEFAULT_MAX_STEP = 0.1
"""Longest integration step [s]; error of a 0.5 s interval about 2e-4 at the 99th percentile."""


_Rates = Callable[
    [Expression, Expression, Expression], tuple[Expression, Expression, Expression]
]
"""(q, u, momentum) -> body rate, velocity of the centre, derivative of the momentum."""


def cf4_step(
    q: Expression, u_start: Expression, u_end: Expression, h: Expression, p: Expression
) -> tuple[Expression, Expression]:
    """Advance one step of h [s] with rotor speeds [rad/s] ramping from `u_start` to `u_end`.

    q is the unit quaternion at its start, p the lumped constants [Rs, c1, r1, r3]. Returned are
    the displacement of the centre [m; world frame], shape (2,), and the quaternion at the end.
    """

    def rates(
        quaternion: Expression, u: Expression, held: Expression
    ) -> tuple[Expression, Expression, Expression]:
        body = body_rate(quaternion, u, p)
        return body, rolling_velocity(ca.mtimes(rotation_matrix(quaternion), body), p[0]), held

    displacement, q_end, _ = _cf4(rates, q, q[0:0], u_start, u_end, h)
    return displacement, q_end


def cf4_drift_step(
    q: Expression,
    momentum: Expression,
    u_start: Expression,
    u_end: Expression,
    h: Expression,
    p: Expression,
    torques: Expression,
) -> tuple[Expression, Expression, Expression]:
    """Advance one step of the model with momentum; on the momentum the method is Runge-Kutta 4.

    Also returns the momentum over I1 at the end of the step. `momentum` is that at its start
    [rad/s; world frame], shape (3,), `torques` as in `momentum_rate`, the rest as in `cf4_step`.
    """

    def rates(
        quaternion: Expression, u: Expression, held: Expression
    ) -> tuple[Expression, Expression, Expression]:
        world = world_rate_with_momentum(quaternion, u, p, held, torques[2:5])
        body = ca.mtimes(rotation_matrix(quaternion).T, world)
        return body, rolling_velocity(world, p[0]), momentum_rate(quaternion, world, p[0], torques)

    return _cf4(rates, q, momentum, u_start, u_end, h)


def _cf4(
    rates: _Rates,
    q: Expression,
    momentum: Expression,
    u_start: Expression,
    u_end: Expression,
    h: Expression,
) -> tuple[Expression, Expression, Expression]:
    """Return displacement, quaternion and momentum after one step of the method."""
    u_middle = 0.5 * (u_start + u_end)

    def turned(quaternion: Expression, rotation: Expression) -> Expression:
        return quaternion_product(quaternion, quaternion_exponential(rotation))

    w1, v1, m1 = rates(q, u_start, momentum)
    q2 = turned(q, 0.5 * h * w1)
    w2, v2, m2 = rates(q2, u_middle, momentum + 0.5 * h * m1)
    q3 = turned(q, 0.5 * h * w2)
    w3, v3, m3 = rates(q3, u_middle, momentum + 0.5 * h * m2)
    q4 = turned(q2, h * (w3 - 0.5 * w1))
    w4, v4, m4 = rates(q4, u_end, momentum + h * m3)
    first = turned(q, h / 12 * (3 * w1 + 2 * w2 + 2 * w3 - w4))
    q_end = turned(first, h / 12 * (-w1 + 2 * w2 + 2 * w3 + 3 * w4))
    displacement = h / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
    return displacement, q_end, momentum + h / 6 * (m1 + 2 * m2 + 2 * m3 + m4)


def steps_for(duration: float, max_step: float = DEFAULT_MAX_STEP) -> int:
    """Return the number of integration steps of an interval of `duration` [s], at least one."""
    # The tolerance keeps 0.5 / 0.1 at 5 steps if 0.5 is the difference of two clock readings.
    return max(1, math.ceil(duration / max_step - 1e-6))


@cache
def step_function() -> ca.Function:
    """Return the CasADi function (x, u_start, u_end, h, p) -> x_end of one step."""
    x, p = ca.SX.sym("x", 6), ca.SX.sym("p", 4)
    u_start, u_end, h = ca.SX.sym("u_start", 2), ca.SX.sym("u_end", 2), ca.SX.sym("h")
    displacement, q_end = cf4_step(x[2:6], u_start, u_end, h, p)
    x_end = ca.vertcat(x[0:2] + displacement, q_end)
    return ca.Function("cf4_step", [x, u_start, u_end, h, p], [x_end])


@cache
def tangent_step_function(directions: int) -> ca.Function:
    """Return the CasADi function of one step with its derivatives along D = `directions`.

    Signature ``(q, u_start, u_end, h, p, dq, du_start, du_end) -> (dxy, q_end, ddxy, dq_end)``;
    the seeds dq (4, D), du_start and du_end (2, D) and the derivatives have one column for each
    direction. The motion does not depend on the position.
    """
    q, p, h = ca.SX.sym("q", 4), ca.SX.sym("p", 4), ca.SX.sym("h")
    u_start, u_end = ca.SX.sym("u_start", 2), ca.SX.sym("u_end", 2)
    dq = ca.SX.sym("dq", 4, directions)
    du_start = ca.SX.sym("du_start", 2, directions)
    du_end = ca.SX.sym("du_end", 2, directions)
    displacement, q_end = cf4_step(q, u_start, u_end, h, p)
    variables = ca.vertcat(q, u_start, u_end)
    seeds = ca.vertcat(dq, du_start, du_end)
    tangent = ca.jtimes(ca.vertcat(displacement, q_end), variables, seeds)
    return ca.Function(
        "tangent_step",
        [q, u_start, u_end, h, p, dq, du_start, du_end],
        [displacement, q_end, tangent[0:2, :], tangent[2:6, :]],
    )


@cache
def drift_step_function() -> ca.Function:
    """Return (x, momentum, u_start, u_end, h, p, torques) -> (x_end, momentum_end) of one step."""
    x, momentum, p = ca.SX.sym("x", 6), ca.SX.sym("momentum", 3), ca.SX.sym("p", 4)
    u_start, u_end, h = ca.SX.sym("u_start", 2), ca.SX.sym("u_end", 2), ca.SX.sym("h")
    torques = ca.SX.sym("torques", 5)
    displacement, q_end, momentum_end = cf4_drift_step(
        x[2:6], momentum, u_start, u_end, h, p, torques
    )
    x_end = ca.vertcat(x[0:2] + displacement, q_end)
    arguments = [x, momentum, u_start, u_end, h, p, torques]
    return ca.Function("cf4_drift_step", arguments, [x_end, momentum_end])


@cache
def tangent_drift_step_function(directions: int, varied: tuple[str, ...]) -> ca.Function:
    """Return the function of one step with momentum and its derivatives along D = `directions`.

    Signature ``(q, momentum, u_start, u_end, h, p, torques, d...) -> (dxy, q_end, momentum_end,
    ddxy, dq_end, dmomentum_end)``, with a seed for each of the arguments `varied`; seeds and
    derivatives have one column for each direction.
    """
    sizes = {"q": 4, "momentum": 3, "u_start": 2, "u_end": 2, "h": 1, "p": 4, "torques": 5}
    arguments = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    seeds = [ca.SX.sym(f"d{name}", sizes[name], directions) for name in varied]
    ends = cf4_drift_step(**arguments)
    variables = ca.vertcat(*(arguments[name] for name in varied))
    tangent = ca.jtimes(ca.vertcat(*ends), variables, ca.vertcat(*seeds))
    return ca.Function(
        "tangent_drift_step",
        [*arguments.values(), *seeds],
        [*ends, tangent[0:2, :], tangent[2:6, :], tangent[6:9, :]],
    )


def parts_of_ramp(start: Vector, end: Vector, steps: int) -> Iterator[tuple[Vector, Vector]]:
    """Yield the inputs at both ends of each of equal steps of an interval."""
    for i in range(steps):
        yield start + (end - start) * (i / steps), start + (end - start) * ((i + 1) / steps)


def integrate_with_drift(
    state: Vector,
    drift: Drift,
    u_start: Vector,
    u_end: Vector,
    duration: float,
    constants: Vector,
    max_step: float = DEFAULT_MAX_STEP,
) -> tuple[Vector, Vector]:
    """Return state (6,) and momentum (3,) [rad/s] after one interval of a first-order hold.

    From a state, shape (6,), and a drift, with the rotor speeds at both ends [rad/s], shape (2,),
    over `duration` [s] in steps of `max_step` [s] at most; `constants` are [Rs, c1, r1, r3].
    """
    steps = steps_for(duration, max_step)
    step, h = drift_step_function(), duration / steps
    torques = np.concatenate((drift.slope, drift.imbalance))
    x, momentum = state, drift.momentum
    for here, there in parts_of_ramp(u_start, u_end, steps):
        ends = step(x, momentum, here, there, h, constants, torques)
        x, momentum = (np.array(end).ravel() for end in ends)
    return x, momentum
