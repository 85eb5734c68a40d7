# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The solver where there is no compiler: NumPy, SciPy and CasADi's virtual machine.

Imported only where it is needed, as loading SciPy takes a third of a node's start.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.native.batch import BatchSolution
from sphere_nmpc.solver.numpy_backend.levenberg_marquardt import minimise
from sphere_nmpc.solver.problem import HoldProblem, HoldSolution, SolverSettings, SolveStatus

__all__ = ["minimise", "solve_batch"]


def solve_batch(
    problems: Sequence[HoldProblem],
    starts: Sequence[Vector],
    settings: SolverSettings,
    stop_at_first: bool,
    time_budget: float,
) -> BatchSolution:
    """Solve one problem after the other; see `HoldSolver.solve_batch`."""
    began = time.perf_counter()
    answers: list[HoldSolution] = []
    done = False
    for problem, start in zip(problems, starts, strict=True):
        left = time_budget - (time.perf_counter() - began)
        if done or left <= 0.0:
            answers.append(_never_begun(problem, start))
            continue
        limited = replace(settings, time_budget=min(settings.time_budget, left))
        answers.append(minimise(problem, start, limited))
        done = stop_at_first and answers[-1].cost <= settings.target_cost
    return BatchSolution(
        [answer.inputs for answer in answers],
        [answer.states for answer in answers],
        np.array([answer.cost for answer in answers]),
        np.array([answer.iterations for answer in answers], dtype=np.int64),
        [answer.status for answer in answers],
        np.array([answer.kkt_residual for answer in answers]),
        np.array([answer.solve_time for answer in answers]),
        settings.target_cost,
    )


def _never_begun(problem: HoldProblem, start: Vector) -> HoldSolution:
    return HoldSolution(
        inputs=np.vstack((problem.input_in_force, start)),
        states=np.full((problem.intervals + 1, 6), np.nan),
        cost=np.inf,
        status=SolveStatus.ABANDONED,
        iterations=0,
        kkt_residual=np.inf,
        solve_time=0.0,
    )
