# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""do-mpc, used as in its examples: multiple shooting, its own warm start."""

from typing import Any

import casadi as ca
import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_sim.benchmark.benchmarked_solver import Answer
from sphere_sim.benchmark.problem import (
    HORIZON,
    INPUT_WEIGHT,
    LIMIT,
    SAMPLE_PERIOD,
    TERMINAL_WEIGHT,
    predicted,
)


class DoMpc:
    """do-mpc; because of the first-order hold the last input is a part of the state."""

    def __init__(self) -> None:
        import do_mpc

        self._do_mpc: Any = do_mpc

    def start(self, goal: Vector) -> None:
        """Start a run without a warm start; see `BenchmarkedSolver`."""
        model = self._do_mpc.model.Model("discrete", "SX")
        state = model.set_variable("_x", "state", (6, 1))
        last = model.set_variable("_x", "last", (2, 1))
        v = model.set_variable("_u", "v", (2, 1))
        model.set_rhs("state", predicted(state, last, LIMIT * v))
        model.set_rhs("last", LIMIT * v)
        model.setup()
        controller = self._do_mpc.controller.MPC(model)
        controller.settings.n_horizon = HORIZON
        controller.settings.t_step = SAMPLE_PERIOD
        controller.settings.n_robust = 0
        controller.settings.store_full_solution = False
        controller.settings.supress_ipopt_output()
        miss = ca.sumsqr(model.x["state"] - goal)
        effort = INPUT_WEIGHT * LIMIT**2 / TERMINAL_WEIGHT * ca.sumsqr(model.u["v"])
        controller.set_objective(mterm=miss, lterm=miss / TERMINAL_WEIGHT + effort)
        controller.bounds["lower", "_u", "v"] = -1.0
        controller.bounds["upper", "_u", "v"] = 1.0
        controller.setup()
        self._controller = controller
        self._has_guess = False

    def solve(self, state: Vector, input_in_force: Vector) -> Answer:
        """Return the next rotor speeds; see `BenchmarkedSolver`."""
        x = np.concatenate((state, input_in_force)).reshape(-1, 1)
        if not self._has_guess:
            self._controller.x0 = x
            self._controller.set_initial_guess()
            self._has_guess = True
        v = np.asarray(self._controller.make_step(x)).ravel()
        return Answer(LIMIT * v, bool(self._controller.solver_stats["success"]))
