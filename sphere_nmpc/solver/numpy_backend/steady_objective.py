# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Cost with an interval of steady rolling, whose whole turns are not integrated."""

import numpy as np

from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_nmpc.solver.numpy_backend.horizon import Horizon
from sphere_nmpc.solver.numpy_backend.objective import VectorObjective, by_all_knots
from sphere_nmpc.solver.problem import HoldProblem


class SteadyObjective(VectorObjective):
    """Cost of the scaled knots v as in `VectorObjective`, with the residual of the tilt."""

    def _set_up_horizon(self, problem: HoldProblem) -> None:
        super()._set_up_horizon(problem)
        m = problem.steady_interval
        durations = problem.durations.copy()
        durations[m] -= problem.whole_turns
        scales = problem.durations / durations
        self._horizon = Horizon(durations, problem.constants, problem.max_step, scales)
        marked = self._horizon.last if self._is_dense else self._horizon.last[[m - 1, -1]]
        self._horizon.columns[marked, 10] = 1.0
        a, b = problem.steady_axis
        # The tilt is 2 (a (x z - w y) + b (y z + w x)) = q . A q.
        upper = np.array([[0, b, -a, 0], [0, 0, 0, a], [0, 0, 0, b], [0, 0, 0, 0]])
        self._form: Vector = upper + upper.T

    def _further_cost(self) -> float:
        return 0.0 if self._is_dense else self._tilt()[0] ** 2

    def _tilt(self) -> tuple[float, Vector]:
        """Return the tilt and its derivative by the rotation e of dq = e (x) q, shape (3,)."""
        problem = self._problem
        q = self._errors[problem.steady_interval - 1, QUATERNION] + problem.goal[QUATERNION]
        by_q = 2.0 * self._form @ q
        w, vector = q[0], q[1:]
        by_e = by_q[1:] * w - by_q[0] * vector + np.cross(vector, by_q[1:])
        return float(q @ self._form @ q), by_e

    def _terminal_rows(self) -> tuple[Vector, Vector]:
        m, local = self._problem.steady_interval, self._local_rows()
        tilt, by_e = self._tilt()
        at_start = local.copy()
        at_start[:, :, m:] = 0.0
        local[:, :, :m] = np.einsum("ij,jkl->ikl", self._through()[m], at_start[:, :, :m])
        rows = np.vstack((by_all_knots(local), by_e @ by_all_knots(at_start)[2:]))
        return rows, np.append(self._errors[-1] @ self._to_residual, tilt)
