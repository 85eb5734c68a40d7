# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Cost of a `HoldProblem` with drift, for the NumPy solver; a residual has all six components."""

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

    def _terminal_rows(self) -> tuple[Vector, Vector]:
        return self._sensitivities()[-1], self._errors[-1]

    def _all_rows(self) -> tuple[Vector, Vector]:
        weights = self._root_weights()
        rows = weights[:, :, None] * self._sensitivities()
        return rows.reshape(-1, rows.shape[2]), (weights * self._errors).ravel()

    def _sensitivities(self) -> Vector:
        """Return the derivatives of x_1 ... x_N by v, shape (N, 6, 2 N)."""
        problem, n = self._problem, self._problem.intervals
        by_knot = self._with_drift.sensitivities()[1:].reshape(n, 6, n, 2)
        scaled: Vector = problem.input_scale * by_knot.swapaxes(2, 3).reshape(n, 6, 2 * n)
        return scaled
