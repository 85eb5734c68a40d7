# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Cost of a `HoldProblem` with drift, for the NumPy solver.

A residual has all six components of the state, that at the end one of the momentum besides.
"""

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.numpy_backend.drift_horizon import DriftHorizon
from sphere_nmpc.solver.numpy_backend.objective import VectorObjective
from sphere_nmpc.solver.problem import HoldProblem


class DriftObjective(VectorObjective):
    """Cost of the scaled knots v as in `VectorObjective`, of the model with momentum."""

    def _set_up_horizon(self, problem: HoldProblem) -> None:
        self._with_drift = DriftHorizon(
            problem.durations, problem.constants, problem.max_step, problem.drift
        )

    def _states(self, knots: Vector) -> Vector:
        return self._with_drift.states(self._problem.state, knots)

    def momenta(self, v: Vector) -> Vector:
        """Return the momenta at the knots [rad/s; world frame], shape (N + 1, 3)."""
        self._states(self.inputs(v))
        return self._with_drift.momenta

    def _further_cost(self) -> float:
        residual = float(self._problem.momentum_row @ self._with_drift.momenta[-1])
        return 0.0 if self._is_dense else residual * residual

    def _terminal_rows(self) -> tuple[Vector, Vector]:
        row = self._problem.momentum_row
        by_end = self._by_knots()[-1]
        rows = np.vstack((self._scale[:, None] * by_end[:6], row @ by_end[6:]))
        residual = float(row @ self._with_drift.momenta[-1])
        return rows, np.append(self._errors[-1], residual)

    def _all_rows(self) -> tuple[Vector, Vector]:
        weights = self._root_weights()
        rows = (weights * self._scale)[:, :, None] * self._by_knots()[:, :6]
        return rows.reshape(-1, rows.shape[2]), (weights * self._errors).ravel()

    def _by_knots(self) -> Vector:
        """Return the derivatives of [x_m, h_m], m = 1 ... N, by v, shape (N, 9, 2 N)."""
        problem, n = self._problem, self._problem.intervals
        by_knot = self._with_drift.sensitivities()[1:].reshape(n, 9, n, 2)
        scaled: Vector = problem.input_scale * by_knot.swapaxes(2, 3).reshape(n, 9, 2 * n)
        return scaled
