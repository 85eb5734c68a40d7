# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Integration of the motion under a first-order hold on the rotation group.

A commutator-free Lie group method of order four (CF4 of Celledoni, Marthinsen and Owren, 2003)
composes exponentials of angular velocities, here in world axes, so the quaternion keeps its unit
norm to rounding, and at the robot's speeds one step is as accurate as about two of the classical
Runge-Kutta method, which it is for the momentum.
"""

import math
from functools import cache

import casadi as ca

from sphere_nmpc.model.dynamics import momentum_rate, rolling, world_rate
from sphere_nmpc.model.symbolic_rotation import (
    Expression,
    quaternion_exponential,
    quaternion_product,
)
from sphere_nmpc.model.units import DEFAULT_MAX_STEP

_SIZES = {"q": 4, "momentum": 3, "u_start": 2, "u_end": 2, "h": 1, "p": 4, "torques": 5}
"""Arguments of `cf4_step`."""


def cf4_step(
    q: Expression,
    momentum: Expression,
    u_start: Expression,
    u_end: Expression,
    h: Expression,
    p: Expression,
    torques: Expression,
) -> tuple[Expression, Expression, Expression]:
    """Advance one step of h [s] with rotor speeds [rad/s] ramping from `u_start` to `u_end`.

    For the other arguments see `world_rate` and `momentum_rate` of `sphere_nmpc.model.dynamics`.
    Returned are the displacement of the centre [m; world frame], shape (2,), the quaternion and
    the momentum at the end.
    """
    u_middle = 0.5 * (u_start + u_end)

    def rates(q: Expression, momentum: Expression, u: Expression) -> tuple[Expression, Expression]:
        rate = world_rate(q, momentum, u, p, torques[2:5])
        return rate, momentum_rate(q, rate, p[0], torques)

    def turned(q: Expression, rotation: Expression) -> Expression:
        return quaternion_product(quaternion_exponential(rotation), q)

    w1, m1 = rates(q, momentum, u_start)
    q2 = turned(q, 0.5 * h * w1)
    w2, m2 = rates(q2, momentum + 0.5 * h * m1, u_middle)
    q3 = turned(q, 0.5 * h * w2)
    w3, m3 = rates(q3, momentum + 0.5 * h * m2, u_middle)
    q4 = turned(q2, h * (w3 - 0.5 * w1))
    w4, m4 = rates(q4, momentum + h * m3, u_end)
    middle = 2 * (w2 + w3)
    first = h / 12 * (middle + 3 * w1 - w4)
    second = h / 12 * (middle - w1 + 3 * w4)
    # Rolling is linear in the angular velocity, of which the sum of both is the mean times h.
    displacement = rolling(first + second, p[0])
    q_end = turned(turned(q, first), second)
    return displacement, q_end, momentum + h / 6 * (m1 + 2 * (m2 + m3) + m4)


def steps_for(duration: float, max_step: float = DEFAULT_MAX_STEP) -> int:
    """Return the number of integration steps of an interval of `duration` [s], at least one."""
    # The tolerance keeps 0.5 / 0.1 at 5 steps if 0.5 is the difference of two clock readings.
    return max(1, math.ceil(duration / max_step - 1e-6))


@cache
def step_function() -> ca.Function:
    """Return the CasADi function (x, u_start, u_end, h, p) -> x_end of one step.

    x is a pose, shape (6,): this is the paper's model, without momentum and torques. The rotor
    speeds, shape (2,) [rad/s], ramp over h [s]; p has the lumped constants [Rs, c1, r1, r3].
    """
    x, (_, _, u_start, u_end, h, p, _) = ca.SX.sym("x", 6), _arguments().values()
    displacement, q_end, _ = cf4_step(
        x[2:6], ca.DM.zeros(3), u_start, u_end, h, p, ca.DM.zeros(5)
    )
    x_end = ca.vertcat(x[0:2] + displacement, q_end)
    return ca.Function("cf4_step", [x, u_start, u_end, h, p], [x_end])


@cache
def tangent_step_function(
    directions: int, varied: tuple[str, ...], undisturbed: bool = False
) -> ca.Function:
    """Return the CasADi function of one step with its derivatives along D = `directions`.

    Its arguments are those of `cf4_step` and a seed dA for each A of them that is `varied`; its
    results dxy, q_end, momentum_end and their derivatives. Seeds and derivatives have one column
    for each direction. `undisturbed`: without momentum and torques, which are then no arguments.
    """
    symbols = _arguments()
    arguments, still = dict(symbols), ("momentum", "torques") if undisturbed else ()
    for name in still:
        symbols[name] = ca.DM.zeros(_SIZES[name])
        del arguments[name]
    found = zip(("dxy", "q_end", "momentum_end"), cf4_step(**symbols), strict=True)
    ends = {name: end for name, end in found if not (undisturbed and name == "momentum_end")}
    seeds = {f"d{name}": ca.SX.sym(f"d{name}", _SIZES[name], directions) for name in varied}
    tangents = {
        f"d{name}": ca.jtimes(
            end, ca.vertcat(*(symbols[name] for name in varied)), ca.vertcat(*seeds.values())
        )
        for name, end in ends.items()
    }
    given, results = arguments | seeds, ends | tangents
    return ca.Function(
        "tangent_step", [*given.values()], [*results.values()], [*given], [*results]
    )


def _arguments() -> dict[str, Expression]:
    return {name: ca.SX.sym(name, size) for name, size in _SIZES.items()}
