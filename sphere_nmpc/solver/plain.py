# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The solver in its readable form, which takes the place of the compiled one where there is none.

Tests compare the compiled solver with it. The steps are the same but for rounding and take about
300 times as long.
"""

import math
import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from sphere_nmpc.model.disturbance import Disturbance, after_slope, rest_speeds
from sphere_nmpc.model.integrator import steps_for, tangent_step_function
from sphere_nmpc.model.state import INPUT_SIZE, MOMENTUM, POSE, POSITION, QUATERNION, Vector
from sphere_nmpc.solver.problem import (
    End,
    LeastSquaresProblem,
    Problem,
    Solution,
    SolverSettings,
    SolveStatus,
)

MIN_DAMPING = 1e-12
MAX_DAMPING = 1e12
BOUND_PASSES = 4
"""Largest number of solves for one step, each with more components fixed at their bounds."""

_CARRIED = 7
"""Quaternion and momentum: the numbers at the start of an interval that affect its motion."""
_BY_KNOTS = ("q", "momentum", "u_start", "u_end", "h")
_BY_PLANT = ("q", "momentum", "p", "torques")


class Motion(NamedTuple):
    """States along a first-order hold of N intervals.

    Attributes
    ----------
    states : ndarray, shape (N + 1, 9)
        At the knots.
    derivatives : ndarray, shape (N + 1, 9, 2 N)
        d x_m / d (u_1, ..., u_N), per rad/s; zero where they are not asked for.
    by_stretch : ndarray, shape (N + 1, 9)
        d x_m / d log of the factor on all durations; zero where it is not asked for.
    """

    states: Vector
    derivatives: Vector
    by_stretch: Vector


def shoot(
    state: Vector, torques: Vector, inputs: Vector, durations: Vector, constants: Vector,
    max_step: float, left_out: Vector | None = None, derive: bool = False, stretch: float = 1.0,
) -> Motion:
    """Predict the motion along a first-order hold, differentiated by the knots if asked for.

    Parameters as for `sphere_nmpc.solver.roll_out.roll_out`; `torques`, shape (5,), are those of
    the disturbance [rad/s^2]. `left_out`, shape (N,), is the time
    [s] in each interval that is not integrated, but adds to the way in proportion. `stretch` is a
    factor on all durations, which does not change the number of integration steps.
    """
    n = durations.size
    # Directions of an interval: quaternion and momentum at its start, its two knots, its duration.
    seeds = np.eye(_CARRIED + 5) if derive else np.zeros((_CARRIED + 5, 0))
    first, second = seeds[_CARRIED : _CARRIED + 2], seeds[_CARRIED + 2 : _CARRIED + 4]
    step = _Step(seeds.shape[1], _BY_KNOTS)
    ends, derivatives = np.empty((n + 1, 9)), np.zeros((n + 1, 9, 2 * n))
    ends[0], by_stretch = state, np.zeros((n + 1, 9))

    def by_knots(a: float, b: float) -> tuple[Vector, Vector, Vector]:
        by_step = (b - a) * seeds[_CARRIED + 4 :]
        return (1.0 - a) * first + a * second, (1.0 - b) * first + b * second, by_step

    for m in range(n):
        whole, out = stretch * float(durations[m]), 0.0 if left_out is None else float(left_out[m])
        duration = whole - out
        scale, steps = whole / duration, steps_for(float(durations[m]) - out, max_step)
        way, dway, y, dy = step.through(
            ends[m, 2:], seeds[:_CARRIED], inputs[m : m + 2], duration, steps, constants,
            torques, by_knots,
        )
        ends[m + 1] = np.concatenate((ends[m, :2] + scale * way, y))
        if derive:
            local, after = np.vstack((scale * dway, dy)), derivatives[m + 1]
            by_duration = local[:, _CARRIED + 4].copy()
            by_duration[:2] -= out / duration**2 * way
            by_stretch[m + 1] = local[:, :_CARRIED] @ by_stretch[m, 2:] + whole * by_duration
            by_stretch[m + 1, :2] += by_stretch[m, :2]
            after[:] = local[:, :_CARRIED] @ derivatives[m, 2:]
            after[:2] += derivatives[m, :2]
            if m > 0:
                after[:, 2 * m - 2 : 2 * m] += local[:, _CARRIED : _CARRIED + 2]
            after[:, 2 * m : 2 * m + 2] += local[:, _CARRIED + 2 : _CARRIED + 4]
    return Motion(ends, derivatives, by_stretch)


def propagate(
    state: Vector, torques: Vector, inputs: Vector, durations: Vector, constants: Vector,
    max_step: float,
) -> tuple[Vector, Vector]:
    """Return the end of a first-order hold and the derivatives of its error, (8, 15).

    They are by rotation and momentum at the start, constants and torques; the parameters are those
    of `shoot`.
    """
    seeds = np.eye(15)
    way: Vector = state[:2]
    dway: Vector = np.zeros((2, 15))
    y: Vector = state[2:]
    dy: Vector = np.zeros((_CARRIED, 15))
    # q exp(r / 2) to first order.
    dy[:4, :3], dy[4:] = 0.5 * _right_product(y[:4])[:, 1:], seeds[3:6]
    step = _Step(15, _BY_PLANT)
    for m, duration in enumerate(durations):
        moved, dmoved, y, dy = step.through(
            y, dy, inputs[m : m + 2], float(duration), steps_for(float(duration), max_step),
            constants, torques, lambda a, b: (seeds[6:10], seeds[10:]),
        )
        way, dway = way + moved, dway + dmoved
    turn = 2.0 * _right_product(y[:4])[:, 1:].T @ dy[:4]
    return np.concatenate((way, y)), np.vstack((dway, turn, dy[4:]))


def _right_product(q: Vector) -> Vector:
    """Return the matrix M of q p = M p, of which the transpose belongs to the conjugate of q."""
    w, x, y, z = q
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])


class _Step:
    """`tangent_step_function` with arrays of its own for arguments and results.

    Without a conversion of arguments, within which CasADi would lose an interrupt by Ctrl-C.
    """

    def __init__(self, directions: int, varied: tuple[str, ...]) -> None:
        function = tangent_step_function(directions, varied)
        # CasADi stores matrices by columns: each array is the transpose of one.
        self._given = [np.zeros(function.size_in(i)[::-1]) for i in range(function.n_in())]
        self._found = [np.zeros(function.size_out(i)[::-1]) for i in range(function.n_out())]
        self._buffer: Any
        self._buffer, self._run = function.buffer()
        for i, array in enumerate(self._given):
            self._buffer.set_arg(i, array.data)
        for i, array in enumerate(self._found):
            self._buffer.set_res(i, array.data)

    def __call__(self, *arguments: Vector | float) -> list[Vector]:
        for array, value in zip(self._given, arguments, strict=True):
            array[:] = np.transpose(value)
        self._run()
        return [array.T.copy() for array in self._found]

    def through(
        self, y: Vector, dy: Vector, knots: Vector, duration: float, steps: int,
        constants: Vector, torques: Vector, seeds: Callable[[float, float], Iterable[Vector]],
    ) -> tuple[Vector, Vector, Vector, Vector]:
        """Move [q, h] over an interval between knots (2, 2); return the way and [q, h].

        Each with its derivatives from `dy` on: way, dway, y, dy. `seeds` returns the further ones
        of a step from a share of the interval to another.
        """
        start, change = knots[0], knots[1] - knots[0]
        way: Vector = np.zeros(2)
        dway: Vector = np.zeros((2, dy.shape[1]))
        for i in range(steps):
            a, b = i / steps, (i + 1) / steps
            moved, q, momentum, d_moved, dq, d_momentum = self(
                y[:4], y[4:], start + a * change, start + b * change, duration / steps,
                constants, torques, dy[:4], dy[4:], *seeds(a, b),
            )
            way, dway = way + moved.ravel(), dway + d_moved
            y, dy = np.concatenate((q, momentum)).ravel(), np.vstack((dq, d_momentum))
        return way, dway, y, dy


def bounds_of(problem: Problem) -> tuple[Vector, Vector]:
    """Return the bounds of the knots, (N, 2) each: equal ones for the last where the end fixes it.

    That is where the momentum at the end is known before the motion is.
    """
    lower, upper = problem.lower, problem.upper
    is_known = isinstance(problem, LeastSquaresProblem) or not problem.disturbed
    if problem.end is End.FREE or not is_known:
        return lower, upper
    disturbance, duration = Disturbance.from_array(problem.torques), problem.durations.sum()
    momentum = after_slope(problem.state[MOMENTUM], disturbance, duration)
    speeds = aim_of(problem) + rest_speeds(momentum, problem.goal[QUATERNION])
    lower, upper = lower.copy(), upper.copy()
    lower[-1] = upper[-1] = np.fmin(np.fmax(speeds, lower[-1]), upper[-1])
    return lower, upper


def aim_of(problem: Problem) -> Vector:
    """Return u_f, the speeds at an end that is not free, beyond what holds the momentum, (2,)."""
    return problem.end_speeds if problem.end is End.STATE else np.zeros(INPUT_SIZE)


class Expansion(NamedTuple):
    """Cost of a `LeastSquaresProblem` and its Gauss-Newton model at scaled knots v = u / U.

    Attributes
    ----------
    v : ndarray, shape (2 N,)
        The point.
    cost : float
        Value of the objective.
    gradient : ndarray, shape (2 N,)
        Its gradient by v.
    hessian : ndarray, shape (2 N, 2 N)
        Its Hessian without the second derivatives of the states.
    inputs : ndarray, shape (N + 1, 2)
        u_0 ... u_N [rad/s].
    motion : Motion
        The motion along them.
    """

    v: Vector
    cost: float
    gradient: Vector
    hessian: Vector
    inputs: Vector
    motion: Motion


def shoot_knots(
    problem: Problem, v: Vector, left_out: Vector | None = None, stretch: float = 1.0
) -> tuple[Vector, Motion]:
    """Return the inputs u_0 ... u_N at scaled knots v, (2 N,), and the motion along them."""
    inputs = np.vstack((problem.input_in_force, problem.input_scale * v.reshape(-1, INPUT_SIZE)))
    return inputs, shoot(
        problem.state, problem.torques, inputs, problem.durations, problem.constants,
        problem.max_step, left_out, derive=True, stretch=stretch,
    )


def expand(problem: LeastSquaresProblem, v: Vector) -> Expansion:
    """Return the cost, a sum of weighted squares, and its model at scaled knots v, (2 N,)."""
    inputs, motion = shoot_knots(problem, v)
    cost, gradient, hessian = 0.0, np.zeros(v.size), np.zeros((v.size, v.size))
    for weight, residual, jacobian in _residuals(problem, v, inputs, motion):
        cost += weight * float(residual @ residual)
        gradient += 2.0 * weight * residual @ jacobian
        hessian += 2.0 * weight * jacobian.T @ jacobian
    return Expansion(v, cost, gradient, hessian, inputs, motion)


def _residuals(
    problem: LeastSquaresProblem, v: Vector, inputs: Vector, motion: Motion
) -> list[tuple[float, Vector, Vector]]:
    """Return weight, residual and Jacobian by v of each term of the cost."""
    states, by_v = motion.states, problem.input_scale * motion.derivatives
    turn_scale = float(np.max(problem.turn_weights))
    scale = np.array([problem.position_scale] * 2 + [turn_scale] * 4)
    goals = np.tile(problem.goal, (problem.intervals, 1))
    goals[:, POSITION] += np.outer(np.cumsum(problem.durations), problem.goal_velocity)
    weights = np.full(problem.intervals, problem.stage_weight)
    weights[-1] = 1.0
    terms = [
        (weight, scale * (states[m, POSE] - goals[m - 1]), scale[:, None] * by_v[m, POSE])
        for m, weight in enumerate(weights, start=1)
    ]
    unit = np.eye(v.size)
    reference = np.tile(problem.input_reference / problem.input_scale, problem.intervals)
    terms.append((problem.input_weight, v - reference, unit))
    change = np.diff(inputs, axis=0)
    limit = problem.max_acceleration * problem.durations[:, None]
    excess = (change - np.clip(change, -limit, limit)).ravel() / problem.input_scale
    difference = (unit - np.eye(v.size, k=-INPUT_SIZE)) * (excess != 0.0)[:, None]
    terms.append((1.0, excess, difference))
    return terms


def minimise(
    problem: LeastSquaresProblem, start: Vector, settings: SolverSettings, time_budget: float
) -> Solution:
    """Solve a problem by a projected Levenberg-Marquardt iteration.

    Each trial step minimises the damped Gauss-Newton model within the bounds. The damping follows
    the gain ratio (Nielsen's rule). Second derivatives of the states are left out: near a singular
    configuration of the robot they make the Hessian indefinite and a line search stall, while the
    damped model always has a descent direction. `start`, shape (N, 2), is the initial guess of the
    knots u_1 ... u_N [rad/s]; it is clipped to the bounds. `time_budget` is in s.
    """
    began = time.perf_counter()
    bounds = bounds_of(problem)
    lower, upper, v = (knots.ravel() / problem.input_scale for knots in (*bounds, start))
    here = expand(problem, np.clip(v, lower, upper))
    residual = _kkt_residual(here, lower, upper) if math.isfinite(here.cost) else math.inf
    damping, growth, small, iterations = settings.initial_damping, 2.0, False, 0
    status = None
    while True:
        if not math.isfinite(residual):
            status = SolveStatus.NOT_FINITE
        elif small or residual <= settings.gradient_tolerance or here.cost <= settings.target_cost:
            status = SolveStatus.CONVERGED
        elif damping > MAX_DAMPING:
            status = SolveStatus.STALLED
        elif iterations >= settings.max_iterations:
            status = SolveStatus.CAPPED
        elif time.perf_counter() - began > time_budget:
            status = SolveStatus.BUDGET
        if status is not None:
            break
        iterations += 1
        step = _bounded_step(here, damping, lower - here.v, upper - here.v)
        # Without a step, as the matrix is singular to working precision, the cost is the same.
        trial = here if step is None else expand(problem, np.clip(here.v + step, lower, upper))
        decrease = here.cost - trial.cost
        if step is not None and math.isfinite(trial.cost) and decrease > 0.0:
            predicted = -float(here.gradient @ step + 0.5 * step @ here.hessian @ step)
            gain = min(decrease / max(predicted, 1e-300), 1.0)
            damping *= max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
            damping, growth = max(damping, MIN_DAMPING), 2.0
            small = decrease <= max(
                settings.decrease_tolerance * here.cost, settings.decrease_floor
            )
            here, residual = trial, _kkt_residual(trial, lower, upper)
        else:
            damping *= growth
            growth *= 2.0
    inputs = here.inputs.copy()
    # U (u / U) may differ from u in the last place: a bound is met exactly all the same.
    inputs[1:] = np.clip(inputs[1:], *bounds)
    elapsed = time.perf_counter() - began
    return Solution(
        inputs, here.motion.states, problem.durations, here.cost, status, iterations, residual,
        elapsed,
    )


def _bounded_step(here: Expansion, damping: float, down: Vector, up: Vector) -> Vector | None:
    """Minimise the damped model over steps between `down` (<= 0) and `up` (>= 0), shape (2 N,).

    Active set: components at a bound whose gradient points outward are fixed there. Components
    that the step would move across a bound are then fixed at it, and the step is solved again.
    None where the matrix is singular to working precision.
    """
    gradient = here.gradient
    free = (down < up) & ((down < 0.0) | (gradient < 0.0)) & ((up > 0.0) | (gradient > 0.0))
    step: Vector = np.zeros(gradient.size)
    for _ in range(BOUND_PASSES):
        if not free.any():
            break
        step[free] = 0.0
        right = -(gradient + here.hessian @ step)[free]
        matrix = here.hessian[np.ix_(free, free)] + damping * np.eye(right.size)
        try:
            np.linalg.cholesky(matrix)  # fails unless it is positive definite
            step[free] = np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:
            return None
        found, step = step, np.clip(step, down, up)
        crossed = free & (found != step)
        if not crossed.any():
            break
        free &= ~crossed
    return step if np.isfinite(step).all() else None


def _kkt_residual(here: Expansion, lower: Vector, upper: Vector) -> float:
    """Return the largest component of P(v - g) - v; NaN where one of g is not finite."""
    # The projection onto the bounds could hide it.
    if not np.isfinite(here.gradient).all():
        return math.nan
    return float(np.abs(np.clip(here.v - here.gradient, lower, upper) - here.v).max())
