# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Projected Levenberg-Marquardt iteration with bounds, in its readable form.

Each trial step minimises the damped Gauss-Newton model over the decision variables that are not in
the active set; variables that the step would move across a bound are fixed there, and the step is
solved again. The damping follows the gain ratio (Nielsen's rule). Second derivatives of the states
are left out: near a singular configuration of the robot they make the Hessian indefinite and a
line search stall, while the damped model always has a descent direction.
"""

import math
import time

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.numpy_backend.drift_objective import DriftObjective
from sphere_nmpc.solver.numpy_backend.objective import VectorObjective
from sphere_nmpc.solver.numpy_backend.quadratic_model import QuadraticModel
from sphere_nmpc.solver.numpy_backend.steady_objective import SteadyObjective
from sphere_nmpc.solver.problem import (
    HoldProblem,
    HoldSolution,
    SolverSettings,
    SolveStatus,
)

MIN_DAMPING = 1e-12
MAX_DAMPING = 1e12


def minimise(problem: HoldProblem, start: Vector, settings: SolverSettings) -> HoldSolution:
    """Solve a problem from an initial guess; the compiled solver takes the same steps.

    Parameters
    ----------
    problem : HoldProblem
        The problem.
    start : ndarray, shape (N, 2)
        Initial guess of the knots u_1 ... u_N [rad/s]; clipped to the bounds.
    settings : SolverSettings
        When to stop.

    Returns
    -------
    HoldSolution
    """
    began = time.perf_counter()
    objective = _objective(problem)
    lower, upper = objective.lower, objective.upper
    v = _clipped(objective.scaled(start), lower, upper)
    value, states = objective.evaluate(v)
    status = SolveStatus.CAPPED
    iterations = 0
    damping, growth = settings.initial_damping, 2.0
    residual, small = np.inf, False
    model: QuadraticModel | None = None
    if not math.isfinite(value):
        status = SolveStatus.NOT_FINITE
    while status is not SolveStatus.NOT_FINITE:
        if model is None:
            model = objective.expand(v)
            residual = _kkt_residual(v, model.gradient, lower, upper)
            if not math.isfinite(residual):
                status = SolveStatus.NOT_FINITE
                break
            if (
                small
                or residual <= settings.gradient_tolerance
                or value <= settings.target_cost
            ):
                status = SolveStatus.CONVERGED
                break
        if iterations >= settings.max_iterations:
            break
        if time.perf_counter() - began > settings.time_budget:
            status = SolveStatus.BUDGET
            break
        iterations += 1
        step = model.bounded_step(damping, lower - v, upper - v)
        # Singular to working precision: no decrease, so the damping is raised.
        trial, trial_value, trial_states = v, math.nan, states
        if step is not None:
            trial = _clipped(v + step, lower, upper)
            trial_value, trial_states = objective.evaluate(trial)
        decrease = value - trial_value
        if step is not None and math.isfinite(trial_value) and decrease > 0.0:
            gain = decrease / max(model.decrease(step), 1e-300)
            damping *= max(1.0 / 3.0, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
            damping = max(damping, MIN_DAMPING)
            growth = 2.0
            small = decrease <= max(settings.decrease_tolerance * value, settings.decrease_floor)
            v, value, states, model = trial, trial_value, trial_states, None
        else:
            damping *= growth
            growth *= 2.0
            if damping > MAX_DAMPING:
                status = SolveStatus.STALLED
                break
    inputs = objective.inputs(v)
    inputs[1:] = np.clip(inputs[1:], problem.lower, problem.upper)
    momenta = objective.momenta(v)
    elapsed = time.perf_counter() - began
    return HoldSolution(inputs, states, momenta, value, status, iterations, residual, elapsed)


def _clipped(v: Vector, lower: Vector, upper: Vector) -> Vector:
    # Several times faster than numpy.clip on so few numbers.
    clipped: Vector = np.minimum(np.maximum(v, lower), upper)
    return clipped


def _kkt_residual(v: Vector, gradient: Vector, lower: Vector, upper: Vector) -> float:
    # A component that is not finite could be hidden by the projection onto the bounds.
    if not np.isfinite(gradient).all():
        return math.nan
    return float(np.abs(_clipped(v - gradient, lower, upper) - v).max())


def _objective(problem: HoldProblem) -> VectorObjective:
    if problem.drift.any():
        return DriftObjective(problem)
    return SteadyObjective(problem) if problem.steady_interval else VectorObjective(problem)
