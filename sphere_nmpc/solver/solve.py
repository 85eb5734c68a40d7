# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Solution of both problems, by the compiled solver or the plain one."""

import math
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.native.library import Batch, library
from sphere_nmpc.solver.problem import LeastSquaresProblem, Problem, Solution, SolverSettings

_BATCHES = threading.local()
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
    return solve_all((problem,), (start,), settings, time_budget)[0]


def solve_all(
    problems: Sequence[Problem], starts: Sequence[Vector], settings: SolverSettings,
    time_budget: float = math.inf,
) -> list[Solution]:
    """Solve problems of one kind, at least one, in one call, each as `solve` does.

    They may differ in all but the settings. The time budget is that of all of them.
    """
    compiled, kind = library(), type(problems[0])
    if compiled is None:
        from sphere_nmpc.solver.minimum_time import minimise_time  # loads CasADi
        from sphere_nmpc.solver.plain import minimise

        end = time.perf_counter() + time_budget
        run: Any = minimise if kind is LeastSquaresProblem else minimise_time
        return [
            run(problem, start, settings, end - time.perf_counter())
            for problem, start in zip(problems, starts, strict=True)
        ]
    batches: dict[Any, Batch] = _BATCHES.__dict__
    batch = batches.get(kind)
    if batch is None:
        batch = batches[kind] = Batch(compiled, kind)
    return batch.solve(problems, starts, settings, time_budget)
