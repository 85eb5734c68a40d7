# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Solver of `HoldProblem`, compiled or plain."""

import threading
from dataclasses import replace
from typing import Any

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.minimum_time import minimise_time
from sphere_nmpc.solver.native.library import Slot, library
from sphere_nmpc.solver.plain import minimise
from sphere_nmpc.solver.problem import HoldProblem, HoldSolution, SolverSettings


class HoldSolver:
    """Solver of both kinds of problems; safe to call from several threads.

    Parameters
    ----------
    settings : SolverSettings, optional
        When to stop.
    """

    def __init__(self, settings: SolverSettings | None = None) -> None:
        self.settings = SolverSettings() if settings is None else settings
        # Loaded now rather than within the first solve.
        self._compiled = library()
        self._slots = threading.local()

    def solve(
        self, problem: HoldProblem, start: Vector, time_budget: float | None = None,
        settings: SolverSettings | None = None,
    ) -> HoldSolution:
        """Solve a problem from the initial guess `start` of the knots u_1 ... u_N, (N, 2) [rad/s].

        It is clipped to the bounds, and in a minimum-time problem moved within the limits of
        acceleration. `time_budget` is the wall time of this solve [s] and `settings` those of
        this solve, instead of the solver's own.
        """
        settings = self.settings if settings is None else settings
        budget = settings.time_budget if time_budget is None else time_budget
        if self._compiled is None:
            plain = minimise_time if problem.error_weight > 0.0 else minimise
            return plain(problem, start, replace(settings, time_budget=budget))
        slots: dict[Any, Any] = self._slots.__dict__
        slot: Slot | None = slots.get(problem.durations.size)
        if slot is None:
            slot = slots[problem.durations.size] = Slot(self._compiled, problem.durations.size)
        slot.write_settings(settings)
        slot.write(problem, start, budget)
        self._compiled.hold_solve(slot.address)
        return slot.read()
