# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Cost of a `HoldProblem` with gradient and Gauss-Newton Hessian, for the NumPy solver.

The same values as in `sphere_nmpc.solver.reference.objective`, in another order: the decision
variables of rotor 1 come before those of rotor 2, so that the terms that couple successive knots
form one tridiagonal matrix. A residual has five components: x, y and the three independent ones of
the quaternion.
"""

import numpy as np

from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_nmpc.solver.numpy_backend.horizon import Horizon
from sphere_nmpc.solver.numpy_backend.quadratic_model import DenseModel, LowRankModel
from sphere_nmpc.solver.problem import HoldProblem

_RESIDUAL_SIZE = 5
_EACH = np.arange(_RESIDUAL_SIZE)


class VectorObjective:
    """Cost of the scaled knots v, shape (2 N,), those of rotor 1 first.

    Parameters
    ----------
    problem : HoldProblem
        The problem.
    """

    def __init__(self, problem: HoldProblem) -> None:
        self._problem = problem
        n = problem.intervals
        self.lower: Vector = (problem.lower.T / problem.input_scale).ravel()
        self.upper: Vector = (problem.upper.T / problem.input_scale).ravel()
        self._is_dense = problem.stage_weight > 0.0 or not problem.terminal_weight > 0.0
        self._set_up_horizon(problem)
        # x and y, and the component of a quaternion's error d along e (x) q: -(e (x) d) . goal.
        w, i, j, k = problem.goal[QUATERNION].tolist()
        self._to_residual = np.zeros((6, _RESIDUAL_SIZE))
        self._to_residual[0, 0] = self._to_residual[1, 1] = 1.0
        self._to_residual[2:, 2:] = ((-i, -j, -k), (w, k, -j), (-k, w, i), (j, -i, w))
        s = problem.position_scale
        self._scale = np.array([s, s, 1.0, 1.0, 1.0, 1.0])
        self._knots: Vector = np.empty((n + 1, 2))
        self._knots[0] = problem.input_in_force
        self._reference = np.repeat(problem.input_reference / problem.input_scale, n)
        self._slew_limit = problem.max_acceleration * problem.durations

    def _set_up_horizon(self, problem: HoldProblem) -> None:
        self._horizon = Horizon(problem.durations, problem.constants, problem.max_step)
        self._horizon.columns[self._horizon.last if self._is_dense else -1, 10] = 1.0
        to_free = -problem.constants[1]
        s = problem.position_scale
        self._by_input = to_free * problem.input_scale * np.array([s, s, 0.5, 0.5, 0.5])

    def momenta(self, v: Vector) -> Vector:
        """Return the momenta at the knots [rad/s; world frame], shape (N + 1, 3)."""
        return np.zeros((self._problem.intervals + 1, 3))

    def scaled(self, inputs: Vector) -> Vector:
        """Return the decision variables v for knots u_1 ... u_N [rad/s], shape (N, 2)."""
        v: Vector = (inputs.T / self._problem.input_scale).ravel()
        return v

    def inputs(self, v: Vector) -> Vector:
        """Return u_0 ... u_N [rad/s], shape (N + 1, 2)."""
        knots = self._knots.copy()
        knots[1:] = self._problem.input_scale * v.reshape(2, -1).T
        return knots

    def evaluate(self, v: Vector) -> tuple[float, Vector]:
        """Return the cost and the states, shape (N + 1, 6)."""
        problem, knots = self._problem, self._knots
        knots[1:] = problem.input_scale * v.reshape(2, -1).T
        states = self._states(knots)
        errors = self._scale * (states[1:] - problem.goal)
        self._errors = errors
        value = problem.terminal_weight * (float(errors[-1] @ errors[-1]) + self._further_cost())
        effort = v - self._reference
        value += problem.input_weight * float(effort @ effort)
        if problem.stage_weight > 0.0:
            value += problem.stage_weight * float(np.vdot(errors[:-1], errors[:-1]))
        if problem.slew_weight > 0.0:
            change = (knots[1:] - knots[:-1]).T
            excess = change - np.minimum(np.maximum(change, -self._slew_limit), self._slew_limit)
            self._excess = excess / problem.input_scale
            value += problem.slew_weight * float(np.vdot(self._excess, self._excess))
        return value, states

    def expand(self, v: Vector) -> DenseModel | LowRankModel:
        """Return the Gauss-Newton model of the cost at v, the point of the last `evaluate`."""
        problem, n = self._problem, self._problem.intervals
        gradient = 2.0 * problem.input_weight * (v - self._reference)
        diagonal = np.full((2, n), 2.0 * problem.input_weight)
        subdiagonal = np.zeros((2, n))
        if problem.slew_weight > 0.0:
            slew_gradient = 2.0 * problem.slew_weight * self._excess
            weight = 2.0 * problem.slew_weight * (slew_gradient != 0.0)
            by_rotor = gradient.reshape(2, n)
            by_rotor += slew_gradient
            by_rotor[:, :-1] -= slew_gradient[:, 1:]
            diagonal += weight
            diagonal[:, :-1] += weight[:, 1:]
            subdiagonal[:, 1:] = -weight[:, 1:]
        if self._is_dense:
            rows, residual = self._all_rows()
            hessian = rows.T @ rows
            flat = hessian.reshape(-1)
            flat[:: 2 * n + 1] += diagonal.ravel()
            flat[1 :: 2 * n + 1] += subdiagonal.ravel()[1:]
            flat[2 * n :: 2 * n + 1] += subdiagonal.ravel()[1:]
            return DenseModel(gradient + rows.T @ residual, hessian)
        jacobian, residual = self._terminal_rows()
        weight = 2.0 * problem.terminal_weight
        return LowRankModel(
            gradient, diagonal.ravel(), subdiagonal.ravel()[1:], jacobian, residual, weight
        )

    def _further_cost(self) -> float:
        """Return the square of a residual that is not one of the state at the end."""
        return 0.0

    def _states(self, knots: Vector) -> Vector:
        return self._horizon.states(self._problem.state, knots)

    def _local_rows(self) -> Vector:
        """Return derivatives by the knots of each interval, scaled, shape (5, 4, N)."""
        horizon, n = self._horizon, self._problem.intervals
        local = horizon.shooting.by_knots[:, : horizon.steps]
        local = np.add.reduceat(local, horizon.begins, axis=1).reshape(_RESIDUAL_SIZE, 4, n)
        local *= self._by_input[:, None, None]
        return local

    def _terminal_rows(self) -> tuple[Vector, Vector]:
        """Return Jacobian (r, 2 N) and residual (r,) of the state at the end."""
        jacobian = by_all_knots(self._local_rows())
        return jacobian, self._errors[-1] @ self._to_residual

    def _through(self) -> Vector:
        """Return derivatives by the state at the start of each interval, shape (N, r, r).

        They are those of the horizon's end, or of the end of the next marked step.
        """
        n = self._problem.intervals
        sensitivity = self._horizon.shooting.sensitivities[:, self._horizon.begins]
        through = np.zeros((n, _RESIDUAL_SIZE, _RESIDUAL_SIZE))
        through[:, _EACH, _EACH] = 1.0
        by_turn = sensitivity[:10].reshape(_RESIDUAL_SIZE, 2, n).transpose(2, 0, 1)
        through[:, 2:, 2:4] = by_turn[:, :3]
        through[:, :2, 2:4] = 2.0 * by_turn[:, 3:]
        through[:, 0, 4], through[:, 1, 4] = -2.0 * sensitivity[11], 2.0 * sensitivity[10]
        through[:, :2, 2:] *= self._problem.position_scale
        return through

    def _all_rows(self) -> tuple[Vector, Vector]:
        """Return weighted Jacobian (r N, 2 N) and residual (r N,) of all states."""
        n, local, through = self._problem.intervals, self._local_rows(), self._through()
        rows, knot = np.zeros((n, _RESIDUAL_SIZE, 2, n)), np.arange(n)
        rows[knot, :, :, knot] = local[:, 2:].transpose(2, 0, 1)
        rows[knot[1:], :, :, knot[:-1]] = local[:, :2, 1:].transpose(2, 0, 1)
        chained = rows.reshape(n, _RESIDUAL_SIZE, 2 * n)
        for m in range(1, n):
            chained[m] += through[m] @ chained[m - 1]
        weights = self._root_weights()
        residual = weights * (self._errors @ self._to_residual)
        return (weights[:, :, None] * chained).reshape(-1, 2 * n), residual.ravel()

    def _root_weights(self) -> Vector:
        """Return the factors of the residuals of all states, shape (N, 1)."""
        problem = self._problem
        weights = np.full((problem.intervals, 1), (2.0 * problem.stage_weight) ** 0.5)
        weights[-1] = (2.0 * problem.terminal_weight) ** 0.5
        return weights


def by_all_knots(local: Vector) -> Vector:
    """Return Jacobian (r, 2 N) from the derivatives by the knots of each interval, (r, 4, N)."""
    rows = local[:, 2:].copy()
    rows[:, :, :-1] += local[:, :2, 1:]
    jacobian: Vector = rows.reshape(local.shape[0], -1)
    return jacobian
