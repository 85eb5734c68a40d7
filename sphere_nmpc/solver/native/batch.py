# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Many solves at once: multi-start searches and sets of problems, on several threads."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.native import memory as compiled
from sphere_nmpc.solver.native.memory import Slot, body_size, library, new_workspace
from sphere_nmpc.solver.problem import HoldProblem, HoldSolution, SolverSettings, SolveStatus

_NO_WINNER = np.iinfo(np.int64).max


@dataclass(frozen=True, eq=False)
class BatchSolution:
    """Answers to a batch, in the order of its starts.

    Attributes
    ----------
    inputs : list of ndarray, shape (N + 1, 2)
        u_0 (in force) to u_N [rad/s] of each.
    states : list of ndarray, shape (N + 1, 6)
        x_0 to x_N of each.
    costs : ndarray, shape (K,)
        Infinite where a solve was never begun.
    iterations : ndarray of int, shape (K,)
        Trial steps taken.
    statuses : list of SolveStatus
        How each ended.
    kkt_residuals : ndarray, shape (K,)
        As in `HoldSolution`.
    solve_times : ndarray, shape (K,)
        Wall time of each [s].
    target_cost : float
        What counts as success.
    """

    inputs: list[Vector]
    states: list[Vector]
    costs: Vector
    iterations: NDArray[np.int64]
    statuses: list[SolveStatus]
    kkt_residuals: Vector
    solve_times: Vector
    target_cost: float

    @property
    def first_success(self) -> int | None:
        """The lowest index whose cost reached the target, or None."""
        reached = np.flatnonzero(self.costs <= self.target_cost)
        return int(reached[0]) if reached.size else None

    @property
    def best(self) -> int:
        """The index of the lowest cost, the first of equals."""
        return int(np.argmin(np.where(np.isnan(self.costs), np.inf, self.costs)))

    def __len__(self) -> int:
        return len(self.statuses)

    def solution(self, i: int) -> HoldSolution:
        """Return one answer, as a solve on its own would have given it."""
        return HoldSolution(
            self.inputs[i],
            self.states[i],
            float(self.costs[i]),
            self.statuses[i],
            int(self.iterations[i]),
            float(self.kkt_residuals[i]),
            float(self.solve_times[i]),
        )


def solve_batch_compiled(
    problems: Sequence[HoldProblem],
    starts: Sequence[Vector],
    settings: SolverSettings,
    threads: int,
    stop_at_first: bool,
    time_budget: float,
) -> BatchSolution:
    """Solve with the compiled solver; see `HoldSolver.solve_batch`."""
    began = library().hold_clock()
    count = len(problems)
    heads = np.zeros((count, compiled.HEAD_SIZE))
    heads[:, compiled.COST] = np.inf
    heads[:, compiled.KKT_RESIDUAL] = np.inf
    heads.view(np.int64)[:, compiled.STATUS] = compiled.STATUSES.index(SolveStatus.ABANDONED)
    sizes = [problem.intervals for problem in problems]
    ends = np.cumsum([body_size(n) for n in sizes], dtype=np.int64)
    memory = np.zeros(int(ends[-1]) if count else 0)
    bodies = np.split(memory, ends[:-1]) if count else []
    slots = [Slot(n, head, body) for n, head, body in zip(sizes, heads, bodies, strict=True)]
    for slot, problem, start in zip(slots, problems, starts, strict=True):
        slot.write(problem)
        slot.write_settings(settings)
        slot.start[:] = start
        slot.inputs[0], slot.inputs[1:], slot.states[:] = problem.input_in_force, start, np.nan
    queue = np.array([0, _NO_WINNER], dtype=np.int64)

    def work() -> None:
        workspace = new_workspace(max(sizes))
        library().hold_solve_many(
            heads.ctypes.data,
            count,
            queue.ctypes.data,
            int(stop_at_first),
            began + time_budget,
            workspace.ctypes.data,
        )

    # The calling thread works too; the library releases the interpreter's lock.
    helpers = [threading.Thread(target=work) for _ in range(min(threads, count) - 1)]
    for helper in helpers:
        helper.start()
    if count:
        work()
    for helper in helpers:
        helper.join()
    numbers = heads.view(np.int64)
    return BatchSolution(
        [slot.inputs for slot in slots],
        [slot.states for slot in slots],
        heads[:, compiled.COST].copy(),
        numbers[:, compiled.ITERATIONS].copy(),
        [compiled.STATUSES[i] for i in numbers[:, compiled.STATUS].tolist()],
        heads[:, compiled.KKT_RESIDUAL].copy(),
        heads[:, compiled.SOLVE_TIME].copy(),
        settings.target_cost,
    )
