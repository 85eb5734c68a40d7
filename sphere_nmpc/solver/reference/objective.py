# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Cost of a `HoldProblem` with its gradient and Gauss-Newton Hessian, in scaled inputs v = u/U."""

import numpy as np

from sphere_nmpc.model.state import INPUT_SIZE, QUATERNION, Vector
from sphere_nmpc.solver.problem import HoldProblem
from sphere_nmpc.solver.reference.shooting import roll_out, roll_out_with_sensitivity


def all_knots(problem: HoldProblem, scaled: Vector) -> Vector:
    """Return u_0 ... u_N [rad/s], shape (N + 1, 2), for scaled free knots v, shape (2 N,)."""
    free = problem.input_scale * scaled.reshape(-1, INPUT_SIZE)
    return np.vstack((problem.input_in_force, free))


def cost(problem: HoldProblem, scaled: Vector) -> tuple[float, Vector]:
    """Return the cost and the states, shape (N + 1, 6), at scaled knots v, shape (2 N,)."""
    inputs = all_knots(problem, scaled)
    states, momentum = roll_out(problem, inputs)
    return _cost_of(problem, inputs, states, momentum), states


def _cost_of(problem: HoldProblem, inputs: Vector, states: Vector, momentum: Vector) -> float:
    errors = _scale(problem) * (states[1:] - problem.goal)
    value = problem.terminal_weight * float(errors[-1] @ errors[-1])
    if not problem.stage_weight > 0.0:
        value += problem.terminal_weight * float(problem.momentum_row @ momentum) ** 2
        value += problem.terminal_weight * tilt(problem, states)[0] ** 2
    value += problem.stage_weight * float(np.sum(errors[:-1] ** 2))
    effort = (inputs[1:] - problem.input_reference) / problem.input_scale
    value += problem.input_weight * float(np.sum(effort**2))
    if problem.slew_weight > 0.0:
        value += problem.slew_weight * float(np.sum(_slew_excess(problem, inputs) ** 2))
    return value


def tilt(problem: HoldProblem, states: Vector) -> tuple[float, Vector]:
    """Return the tilt at the start of steady rolling and its derivative by the quaternion, (4,).

    Both are zero without steady rolling and with drift.
    """
    m = problem.steady_interval
    if m == 0 or problem.drift.any():
        return 0.0, np.zeros(4)
    a, b = problem.steady_axis
    w, x, y, z = states[m, QUATERNION]
    value = 2.0 * (a * (x * z - w * y) + b * (y * z + w * x))
    by_quaternion = (b * x - a * y, a * z + b * w, b * z - a * w, a * x + b * y)
    return float(value), 2.0 * np.array(by_quaternion)


def _scale(problem: HoldProblem) -> Vector:
    """Return the factors on the errors of the state's components, shape (6,)."""
    return np.array([problem.position_scale] * 2 + [1.0] * 4)


def _slew_excess(problem: HoldProblem, inputs: Vector) -> Vector:
    """Signed excess of each knot difference over its limit, scaled, shape (N, 2)."""
    change = np.diff(inputs, axis=0)
    limit = problem.max_acceleration * problem.durations[:, None]
    excess: Vector = (change - np.clip(change, -limit, limit)) / problem.input_scale
    return excess


def expand(problem: HoldProblem, scaled: Vector) -> tuple[Vector, Vector]:
    """Return gradient, (2 N,), and Gauss-Newton Hessian, (2 N, 2 N), of the cost at v, (2 N,).

    Second derivatives of the states are left out.
    """
    inputs = all_knots(problem, scaled)
    states, sensitivities, momentum, by_momentum = roll_out_with_sensitivity(problem, inputs)
    size = scaled.size
    reference = np.tile(problem.input_reference / problem.input_scale, problem.intervals)
    gradient = 2.0 * problem.input_weight * (scaled - reference)
    hessian = 2.0 * problem.input_weight * np.eye(size)
    scale = _scale(problem)
    weights = np.full(problem.intervals, problem.stage_weight)
    weights[-1] = problem.terminal_weight
    for m in range(1, problem.intervals + 1):
        if weights[m - 1] > 0.0:
            jacobian = problem.input_scale * scale[:, None] * sensitivities[m]
            error = scale * (states[m] - problem.goal)
            gradient += 2.0 * weights[m - 1] * jacobian.T @ error
            hessian += 2.0 * weights[m - 1] * jacobian.T @ jacobian
    if not problem.stage_weight > 0.0:
        row = problem.input_scale * problem.momentum_row @ by_momentum
        residual = float(problem.momentum_row @ momentum)
        gradient += 2.0 * problem.terminal_weight * residual * row
        hessian += 2.0 * problem.terminal_weight * np.outer(row, row)
        residual, by_quaternion = tilt(problem, states)
        steady = sensitivities[problem.steady_interval]
        row = problem.input_scale * by_quaternion @ steady[QUATERNION]
        gradient += 2.0 * problem.terminal_weight * residual * row
        hessian += 2.0 * problem.terminal_weight * np.outer(row, row)
    if problem.slew_weight > 0.0:
        _add_slew(problem, inputs, gradient, hessian)
    return gradient, hessian


def _add_slew(problem: HoldProblem, inputs: Vector, gradient: Vector, hessian: Vector) -> None:
    excess = _slew_excess(problem, inputs).ravel()
    for i in np.flatnonzero(excess):
        gradient[i] += 2.0 * problem.slew_weight * excess[i]
        hessian[i, i] += 2.0 * problem.slew_weight
        j = i - INPUT_SIZE
        if j >= 0:
            gradient[j] -= 2.0 * problem.slew_weight * excess[i]
            hessian[j, j] += 2.0 * problem.slew_weight
            hessian[i, j] -= 2.0 * problem.slew_weight
            hessian[j, i] -= 2.0 * problem.slew_weight
