# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Cost of a `HoldProblem` with gradient and Gauss-Newton Hessian, for the NumPy solver.

The same numbers as `sphere_nmpc.solver.reference.objective`, in another order: the decision
variables of rotor 1 come before those of rotor 2, so that what couples successive knots is one
tridiagonal matrix. A miss has five components: x, y and the three independent ones of the
quaternion.
"""

import numpy as np

from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_nmpc.solver.numpy_backend.horizon import Horizon
from sphere_nmpc.solver.numpy_backend.quadratic_model import DenseModel, LowRankModel
from sphere_nmpc.solver.problem import HoldProblem

_MISS = 5
_DIAGONAL = np.arange(_MISS)


class VectorObjective:
    """Cost of the scaled knots v, shape (2 N,), those of rotor 1 first.

    Parameters
    ----------
    problem : HoldProblem
        What to solve.
    """

    def __init__(self, problem: HoldProblem) -> None:
        self._problem = problem
        n = problem.intervals
        self.lower: Vector = (problem.lower.T / problem.input_scale).ravel()
        self.upper: Vector = (problem.upper.T / problem.input_scale).ravel()
        self._horizon = Horizon(problem.durations, problem.constants, problem.max_step)
        self._is_dense = problem.stage_weight > 0.0 or not problem.terminal_weight > 0.0
        self._horizon.columns[self._horizon.last if self._is_dense else -1, 10] = 1.0
        # x and y, and the part of a quaternion's miss m along e (x) q, which is -(e (x) m) . goal.
        w, i, j, k = problem.goal[QUATERNION].tolist()
        self._to_residual = np.zeros((6, _MISS))
        self._to_residual[0, 0] = self._to_residual[1, 1] = 1.0
        self._to_residual[2:, 2:] = ((-i, -j, -k), (w, k, -j), (-k, w, i), (j, -i, w))
        self._knots: Vector = np.empty((n + 1, 2))
        self._knots[0] = problem.input_in_force
        to_free = -problem.constants[1]
        self._by_input = to_free * problem.input_scale * np.array([1.0, 1.0, 0.5, 0.5, 0.5])
        self._reach = problem.max_acceleration * problem.durations

    def scaled(self, inputs: Vector) -> Vector:
        """Return the unknowns for knots u_1 ... u_N [rad/s], shape (N, 2)."""
        unknowns: Vector = (inputs.T / self._problem.input_scale).ravel()
        return unknowns

    def inputs(self, v: Vector) -> Vector:
        """Return u_0 ... u_N [rad/s], shape (N + 1, 2)."""
        knots = self._knots.copy()
        knots[1:] = self._problem.input_scale * v.reshape(2, -1).T
        return knots

    def evaluate(self, v: Vector) -> tuple[float, Vector]:
        """Return the cost and the states, shape (N + 1, 6)."""
        problem, knots = self._problem, self._knots
        knots[1:] = problem.input_scale * v.reshape(2, -1).T
        states = self._horizon.states(problem.state, knots)
        misses = states[1:] - problem.goal
        self._misses = misses
        value = problem.terminal_weight * float(misses[-1] @ misses[-1])
        value += problem.input_weight * float(v @ v)
        if problem.stage_weight > 0.0:
            value += problem.stage_weight * float(np.vdot(misses[:-1], misses[:-1]))
        if problem.slew_weight > 0.0:
            change = (knots[1:] - knots[:-1]).T
            excess = change - np.minimum(np.maximum(change, -self._reach), self._reach)
            self._excess = excess / problem.input_scale
            value += problem.slew_weight * float(np.vdot(self._excess, self._excess))
        return value, states

    def expand(self, v: Vector) -> DenseModel | LowRankModel:
        """Return the Gauss-Newton model of the cost where it was evaluated last, which is v."""
        problem, n = self._problem, self._problem.intervals
        gradient = 2.0 * problem.input_weight * v
        stiff = np.full((2, n), 2.0 * problem.input_weight)
        couple = np.zeros((2, n))
        if problem.slew_weight > 0.0:
            pull = 2.0 * problem.slew_weight * self._excess
            weight = 2.0 * problem.slew_weight * (pull != 0.0)
            bend = gradient.reshape(2, n)
            bend += pull
            bend[:, :-1] -= pull[:, 1:]
            stiff += weight
            stiff[:, :-1] += weight[:, 1:]
            couple[:, 1:] = -weight[:, 1:]
        horizon = self._horizon
        local = horizon.shooting.by_knots[:, : horizon.steps]
        local = np.add.reduceat(local, horizon.begins, axis=1).reshape(_MISS, 4, n)
        local *= self._by_input[:, None, None]
        if self._is_dense:
            rows, residual = self._all_rows(local)
            hessian = rows.T @ rows
            flat = hessian.reshape(-1)
            flat[:: 2 * n + 1] += stiff.ravel()
            flat[1 :: 2 * n + 1] += couple.ravel()[1:]
            flat[2 * n :: 2 * n + 1] += couple.ravel()[1:]
            return DenseModel(gradient + rows.T @ residual, hessian)
        rows = local[:, 2:].copy()
        rows[:, :, :-1] += local[:, :2, 1:]
        jacobian = rows.reshape(_MISS, 2 * n)
        residual = self._misses[-1] @ self._to_residual
        weight = 2.0 * problem.terminal_weight
        return LowRankModel(
            gradient, stiff.ravel(), couple.ravel()[1:], jacobian, residual, weight
        )

    def _all_rows(self, local: Vector) -> tuple[Vector, Vector]:
        """Return Jacobian (5 N, 2 N) and residual (5 N,) of all states, with their weights."""
        problem, n = self._problem, self._problem.intervals
        lever = self._horizon.shooting.levers[:, self._horizon.begins]
        through = np.zeros((n, _MISS, _MISS))
        through[:, _DIAGONAL, _DIAGONAL] = 1.0
        by_turn = lever[:10].reshape(_MISS, 2, n).transpose(2, 0, 1)
        through[:, 2:, 2:4] = by_turn[:, :3]
        through[:, :2, 2:4] = 2.0 * by_turn[:, 3:]
        through[:, 0, 4], through[:, 1, 4] = -2.0 * lever[11], 2.0 * lever[10]
        rows, knot = np.zeros((n, _MISS, 2, n)), np.arange(n)
        rows[knot, :, :, knot] = local[:, 2:].transpose(2, 0, 1)
        rows[knot[1:], :, :, knot[:-1]] = local[:, :2, 1:].transpose(2, 0, 1)
        chained = rows.reshape(n, _MISS, 2 * n)
        for m in range(1, n):
            chained[m] += through[m] @ chained[m - 1]
        weights = np.full((n, 1), (2.0 * problem.stage_weight) ** 0.5)
        weights[-1] = (2.0 * problem.terminal_weight) ** 0.5
        residual = weights * (self._misses @ self._to_residual)
        return (weights[:, :, None] * chained).reshape(-1, 2 * n), residual.ravel()
