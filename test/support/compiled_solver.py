# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled solver and the plain one, each by name."""

import ctypes
import math
from typing import Any

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.minimum_time import minimise_time
from sphere_nmpc.solver.native.library import library
from sphere_nmpc.solver.plain import minimise
from sphere_nmpc.solver.problem import LeastSquaresProblem, Problem, Solution, SolverSettings
from sphere_nmpc.solver.solve import solve


def compiled() -> ctypes.CDLL:
    """Return the compiled solver, which tests require."""
    found = library()
    assert found is not None, "the solver is not built: make venv"
    return found


def solve_compiled(
    problem: Problem, start: Vector, time_budget: float = math.inf, **changes: Any
) -> Solution:
    """Solve with the compiled solver and settings by name."""
    assert compiled()
    return solve(problem, start, _settings(problem, changes), time_budget)


def solve_plain(
    problem: Problem, start: Vector, time_budget: float = math.inf, **changes: Any
) -> Solution:
    """Solve with the plain solver and settings by name."""
    settings = _settings(problem, changes)
    if isinstance(problem, LeastSquaresProblem):
        return minimise(problem, start, settings, time_budget)
    return minimise_time(problem, start, settings, time_budget)


def _settings(problem: Problem, changes: dict[str, Any]) -> SolverSettings:
    damping = 1e-4 if isinstance(problem, LeastSquaresProblem) else 1.0
    return SolverSettings(**{"initial_damping": damping, **changes})
