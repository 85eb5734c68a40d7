# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Calls of every function of the compiled solver, ordinary ones and edge cases.

    sanitized_runs.py FOLDER

Run by ``test_library.py`` with the folder of a solver that `write_sources` prepared.
"""

import sys
import threading
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from compiled_solver import compiled
from solver_problems import make_problem

from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.native import library
from sphere_nmpc.solver.problem import End, MinimumTimeProblem, SolverSettings
from sphere_nmpc.solver.roll_out import propagate, roll_out
from sphere_nmpc.solver.solve import solve, solve_all

SOURCES = Path(__file__).parents[2] / "sphere_nmpc" / "solver" / "native"
HORIZONS = (1, 2, 3, 4, 12)
KINDS = {
    "terminal": {}, "moving and stages": {}, "acceleration": {},
    "stages and acceleration": {"input_weight": 0.0}, "minimum time": {},
}
"""Problems, the last one in minimum time, and what is changed of them."""
FEW, NONE = SolverSettings(max_iterations=12), SolverSettings(max_iterations=0)

DISTURBANCE = Disturbance(np.array([20.0, -5.0]), np.array([3.0, 4.0, -8.0]))


def random_start(n: int) -> Vector:
    """Return knots [rad/s], some beyond the bounds."""
    return np.random.default_rng(n + 1).uniform(-120.0, 120.0, (n, 2))


def ordinary_calls(n: int) -> None:
    """Solve and predict over N intervals with every kind of cost, and steady rolling."""
    rolling = {"steady_axis": np.array([0.6, -0.8]), "whole_turns": -4.0}
    for (kind, changes), disturbance in product(KINDS.items(), (UNDISTURBED, DISTURBANCE)):
        problem = make_problem(
            kind, n, intervals=n, torques=disturbance.as_array(), fixed={}, **changes
        )
        for end in End:
            ended = replace(problem, end=end, end_speeds=np.array([40.0, -300.0]))
            solve(ended, random_start(n), FEW)
        if isinstance(problem, MinimumTimeProblem):
            for k in range(1, n):
                solve(replace(problem, steady_interval=k, **rolling), random_start(n), FEW)
        for predict in (roll_out, propagate):
            predict(
                problem.state, random_start(n + 1), problem.durations, problem.constants,
                problem.max_step, disturbance,
            )


def calls_of_several() -> None:
    """Solve problems of several lengths in one call."""
    for kind, changes in KINDS.items():
        problems = [make_problem(kind, n, intervals=n, fixed={}, **changes) for n in HORIZONS]
        solve_all(problems, [random_start(n) for n in HORIZONS], FEW)


def edge_cases(n: int) -> None:
    """Fixed knots, numbers that are not finite, no time, no iterations, intervals of no length."""
    start = random_start(n)
    for kind, changes in KINDS.items():
        problem = make_problem(kind, n, intervals=n, fixed={}, **changes)
        part = np.where(np.arange(n)[:, None] == n - 1, 0.0, problem.upper)
        for upper in (np.zeros((n, 2)), part, np.full((n, 2), np.inf)):
            solve(replace(problem, lower=-upper, upper=upper), start, FEW)
        for name in ("state", "goal", "input_in_force", "durations", "constants", "lower"):
            for value in (np.nan, np.inf) if name != "durations" else (np.nan, 0.0):
                odd = {name: np.full_like(getattr(problem, name), value)}
                solve(replace(problem, **odd), start, FEW)
        for value in (np.nan, np.inf, 1e300):
            solve(problem, np.full((n, 2), value), FEW)
        solve(problem, start, FEW, 0.0)
        solve(problem, start, NONE)
    state, constants = problem.state, problem.constants
    inputs = np.vstack((problem.input_in_force, start))
    roll_out(state, inputs, np.zeros(n), constants, 0.1, DISTURBANCE)
    roll_out(state, inputs * np.nan, problem.durations, constants, 0.1, DISTURBANCE)


FAULTY = ("workspace.h", "take(base, &used, m + 2)", "take(base, &used, m)")
"""File, a part of the workspace, and the same made too short, as it is while a variable is set."""


def write_sources(folder: Path) -> None:
    """Write the solver's sources with a fault that the environment variable SOLVER_FAULT causes.

    So there is one build, which takes much longer than the calls.
    """
    sources = {
        path.name: path.read_text(encoding="utf-8")
        for pattern in ("*.[ch]", "*.inc") for path in SOURCES.glob(pattern)
    }
    file, right, wrong = FAULTY
    assert right in sources[file]
    either = f'(getenv("SOLVER_FAULT") ? {wrong} : {right})'
    sources[file] = sources[file].replace(right, either)
    sources["solver.c"] = "#include <stdlib.h>\n" + sources["solver.c"]
    for name, text in sources.items():
        (folder / name).write_text(text, encoding="utf-8")


def main() -> None:
    library.FOLDER = Path(sys.argv[1])
    compiled()
    for n in HORIZONS:
        ordinary_calls(n)
        edge_cases(n)
    calls_of_several()
    threads = [threading.Thread(target=ordinary_calls, args=(n,)) for n in (3, 4, 4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print("all done")


if __name__ == "__main__":
    main()
