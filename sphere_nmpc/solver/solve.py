# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Solution of both problems, by the compiled solver or the plain one."""

import math
import threading
from dataclasses import replace
from typing import Any

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.native.library import Slot, library
from sphere_nmpc.solver.problem import LeastSquaresProblem, Problem, Solution, SolverSettings

_SLOTS = threading.local()
_DEFAULTS = SolverSettings()


def solve(
    problem: Problem, start: Vector, settings: SolverSettings = _DEFAULTS,
    time_budget: float = math.inf, **others: Any,
) -> Solution:
    """Solve a problem from the initial guess `start` of the knots u_1 ... u_N, (N, 2) [rad/s].

    It is clipped to the bounds, and in a minimum-time problem moved within the limits of
    acceleration. `others` are fields of `SolverSettings` that differ from `settings`. After
    `time_budget` of wall time [s] the best iterate is returned; it is infinite by default, as a
    budget makes results depend on the machine. Safe to call from several threads.
    """
    if others:
        settings = replace(settings, **others)
    compiled = library()
    if compiled is None:
        from sphere_nmpc.solver.minimum_time import minimise_time  # loads CasADi
        from sphere_nmpc.solver.plain import minimise

        if isinstance(problem, LeastSquaresProblem):
            return minimise(problem, start, settings, time_budget)
        return minimise_time(problem, start, settings, time_budget)
    slots: dict[Any, Slot] = _SLOTS.__dict__
    key = type(problem), problem.durations.size
    slot = slots.get(key)
    if slot is None:
        slot = slots[key] = Slot(compiled, *key)
    return slot.solve(problem, start, settings, time_budget)
