# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Record of the problems that closed loops solve, with their solutions, for `replay.c`.

``python test/native/recorded_solves.py FILE`` writes the solves of the paper's cases with each
strategy, by the library of this processor. Each is the number of its function, the structure
``problem``, and the arrays that it points to.
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO
from unittest import mock

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.native.layout import MEMBERS
from sphere_nmpc.solver.native.library import Slot
from sphere_nmpc.solver.problem import LeastSquaresProblem, Problem, Solution, SolverSettings
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import run_scenario

ARRAYS = ("durations", "lower", "upper", "start", "inputs", "states")
"""In the order in which `replay.c` reads them."""


def record(file: BinaryIO) -> int:
    """Write the solves of the paper's cases; return their number."""
    solve, number = Slot.solve, 0

    def recorded(
        slot: Slot, problem: Problem, start: Vector, settings: SolverSettings, budget: float
    ) -> Solution:
        nonlocal number
        solution, number = solve(slot, problem, start, settings, budget), number + 1
        file.write(np.int64(not isinstance(problem, LeastSquaresProblem)).tobytes())
        for member in MEMBERS:
            value = np.zeros(1) if member.is_pointer else slot.values[member.name]
            file.write(value.tobytes())
        for name in ARRAYS:
            file.write(slot.values[name].tobytes())
        return solution

    with mock.patch.object(Slot, "solve", recorded):
        for strategy in ("time_optimal", "plan_keeping", "paper"):
            settings = replace(StudyConditions().controller, strategy=strategy)
            conditions = StudyConditions(controller=settings, duration=6.0)
            for case in PAPER_CASES.values():
                run_scenario(conditions, case)
    return number


if __name__ == "__main__":
    with Path(sys.argv[1]).open("wb") as file:
        print(f"{record(file)} problems recorded")
