# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Projected Levenberg-Marquardt iteration on a box: the solver, in the form meant for reading.

Each trial step minimises the damped Gauss-Newton model over the inputs that are not held at a
bound; inputs that the step would carry through a bound are held there and the rest is solved
again. The damping follows the gain ratio (Nielsen's rule). Indefinite second derivatives never
enter: near a configuration where the robot is singular the exact Hessian sends a line search to
a standstill, while the damped model always descends.
"""

import time

import numpy as np
import scipy.linalg

from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.solver.objective import Expansion, all_knots, cost, expand
from sphere_nmpc.solver.problem import (
    HoldProblem,
    HoldSolution,
    SolverSettings,
    SolveStatus,
)

MIN_DAMPING = 1e-12
MAX_DAMPING = 1e12
BOUND_PASSES = 4
"""How often a step is solved again after inputs were held at the bounds it would have crossed."""


def solve_in_python(problem: HoldProblem, start: Vector, settings: SolverSettings) -> HoldSolution:
    """Solve a problem from a start; the compiled solver takes the same steps.

    Parameters
    ----------
    problem : HoldProblem
        What to solve.
    start : ndarray, shape (N, 2)
        First guess of the knots u_1 ... u_N [rad/s]; clipped to the bounds.
    settings : SolverSettings
        When to stop.

    Returns
    -------
    HoldSolution
    """
    began = time.perf_counter()
    lower = problem.lower.ravel() / problem.input_scale
    upper = problem.upper.ravel() / problem.input_scale
    v = np.clip(start.ravel() / problem.input_scale, lower, upper)
    value, states = cost(problem, v)
    status = SolveStatus.CAPPED
    iterations = 0
    damping, growth = settings.initial_damping, 2.0
    residual = np.inf
    picture: Expansion | None = None
    if not np.isfinite(value):
        status = SolveStatus.NOT_FINITE
    while status is not SolveStatus.NOT_FINITE:
        if picture is None:
            picture = expand(problem, v)
            residual = _kkt_residual(v, picture.gradient, lower, upper)
            if residual <= settings.gradient_tolerance or value <= settings.target_cost:
                status = SolveStatus.CONVERGED
                break
        if iterations >= settings.max_iterations:
            break
        if time.perf_counter() - began > settings.time_budget:
            status = SolveStatus.BUDGET
            break
        iterations += 1
        step = _bounded_step(picture, damping, v, lower, upper)
        predicted = -float(picture.gradient @ step + 0.5 * step @ picture.hessian @ step)
        trial = np.clip(v + step, lower, upper)
        trial_value, trial_states = cost(problem, trial)
        decrease = value - trial_value
        if np.isfinite(trial_value) and decrease > 0.0:
            gain = decrease / max(predicted, 1e-300)
            damping *= max(1.0 / 3.0, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
            damping = max(damping, MIN_DAMPING)
            growth = 2.0
            small = decrease <= max(settings.decrease_tolerance * value, settings.decrease_floor)
            v, value, states, picture = trial, trial_value, trial_states, None
            if small:
                picture = expand(problem, v)
                residual = _kkt_residual(v, picture.gradient, lower, upper)
                status = SolveStatus.CONVERGED
                break
        else:
            damping *= growth
            growth *= 2.0
            if damping > MAX_DAMPING:
                # No descent left at working precision.
                status = SolveStatus.CONVERGED
                break
    inputs = all_knots(problem, v)
    inputs[1:] = np.clip(inputs[1:], problem.lower, problem.upper)
    elapsed = time.perf_counter() - began
    return HoldSolution(inputs, states, value, status, iterations, residual, elapsed)


def _kkt_residual(v: Vector, gradient: Vector, lower: Vector, upper: Vector) -> float:
    return float(np.max(np.abs(np.clip(v - gradient, lower, upper) - v), initial=0.0))


def _bounded_step(
    picture: Expansion, damping: float, v: Vector, lower: Vector, upper: Vector
) -> Vector:
    """Minimise the damped model over the step, as far as the bounds allow, shape (2 N,)."""
    gradient, size = picture.gradient, v.size
    free = ~(((v <= lower) & (gradient >= 0.0)) | ((v >= upper) & (gradient <= 0.0)))
    free &= lower < upper
    step: Vector = np.zeros(size)
    damped = picture.hessian + damping * np.eye(size)
    for _ in range(BOUND_PASSES):
        if not np.any(free):
            break
        right = -(gradient + damped @ np.where(free, 0.0, step))[free]
        try:
            factor = scipy.linalg.cho_factor(damped[np.ix_(free, free)], lower=True)
        except np.linalg.LinAlgError:
            # Singular to working precision: no decrease, so the damping is raised.
            return np.zeros(size)
        step[free] = scipy.linalg.cho_solve(factor, right)
        too_low, too_high = free & (v + step < lower), free & (v + step > upper)
        if not np.any(too_low | too_high):
            break
        step = np.where(too_low, lower - v, np.where(too_high, upper - v, step))
        free &= ~(too_low | too_high)
    return np.asarray(np.clip(v + step, lower, upper) - v)


def rest_start(problem: HoldProblem) -> Vector:
    """Return the coldest first guess: all knots zero, shape (N, 2)."""
    return np.zeros((problem.intervals, INPUT_SIZE))
