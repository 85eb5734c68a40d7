# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Record of the problems that closed loops solve, with their solutions, for `replay.c`.

``python test/native/recorded_solves.py FILE`` writes the solves of the paper's cases with each
strategy, by the library of this processor. Each is the number of its function, the structure
``problem``, and the arrays that it points to.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO
from unittest import mock

import numpy as np

from sphere_nmpc.solver.native.layout import MEMBERS
from sphere_nmpc.solver.native.library import Batch
from sphere_nmpc.solver.problem import LeastSquaresProblem, Problem, Solution
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import run_scenario

ARRAYS = ("durations", "lower", "upper", "start", "inputs", "states")
"""In the order in which `replay.c` reads them."""


def record(file: BinaryIO) -> int:
    """Write the solves of the paper's cases; return their number."""
    solve, number = Batch.solve, 0

    def recorded(
        batch: Batch, problems: Sequence[Problem], *others: Any
    ) -> list[Solution]:
        nonlocal number
        solutions, number = solve(batch, problems, *others), number + len(problems)
        for problem, row in zip(problems, batch.rows, strict=False):
            file.write(np.int64(not isinstance(problem, LeastSquaresProblem)).tobytes())
            for member in MEMBERS:
                value = np.zeros(1) if member.is_pointer else row[member.name]
                file.write(value.tobytes())
            n = problem.intervals
            for name in ARRAYS:
                size = n + 1 if name in ("inputs", "states") else n
                file.write(row[name][:size].tobytes())
        return solutions

    with mock.patch.object(Batch, "solve", recorded):
        for strategy in ("time_optimal", "plan_keeping", "paper"):
            settings = replace(StudyConditions().controller, strategy=strategy)
            conditions = StudyConditions(controller=settings, duration=6.0)
            for case in PAPER_CASES.values():
                run_scenario(conditions, case)
    return number


if __name__ == "__main__":
    with Path(sys.argv[1]).open("wb") as file:
        print(f"{record(file)} problems recorded")
