# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The solver as the rest of the package calls it: compiled where possible."""

import threading
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.backend import resolve_backend
from sphere_nmpc.solver.native.batch import BatchSolution, solve_batch_compiled
from sphere_nmpc.solver.native.memory import TIME_BUDGET, Slot, library
from sphere_nmpc.solver.problem import HoldProblem, HoldSolution, SolverSettings

_NUMPY_SOLVER = "sphere_nmpc.solver.numpy_backend.solver"


class HoldSolver:
    """Solves `HoldProblem` after `HoldProblem`; safe to share between threads.

    Parameters
    ----------
    settings : SolverSettings, optional
        When to stop.
    backend : str, optional
        "compiled": C, built at the first use on this machine. "numpy": NumPy and CasADi's virtual
        machine; no compiler needed, the same steps twenty to fifty times slower. "auto": see
        `resolve_backend`.

    Raises
    ------
    CompilerError
        If "compiled" is required and the compiled solver can neither be loaded nor built.
    InvalidParameterError
        If `backend` is another word.
    """

    def __init__(self, settings: SolverSettings | None = None, backend: str = "auto") -> None:
        self.settings = SolverSettings() if settings is None else settings
        self.backend = resolve_backend(backend)
        self._slots = threading.local()
        # Loaded only where it is needed, and now rather than within the first solve.
        self._numpy: Any = import_module(_NUMPY_SOLVER) if self.backend == "numpy" else None

    def solve(
        self, problem: HoldProblem, start: Vector, time_budget: float | None = None
    ) -> HoldSolution:
        """Solve a problem from a start.

        Parameters
        ----------
        problem : HoldProblem
            What to solve.
        start : ndarray, shape (N, 2)
            First guess of the knots u_1 ... u_N [rad/s]; clipped to the bounds.
        time_budget : float, optional
            Wall time of this solve [s], instead of the one in the settings.

        Returns
        -------
        HoldSolution
        """
        settings = self.settings
        budget = settings.time_budget if time_budget is None else time_budget
        if self.backend == "numpy":
            limited = replace(settings, time_budget=budget)
            answer: HoldSolution = self._numpy.minimise(problem, start, limited)
            return answer
        slot = self._slot(problem.durations.size)
        slot.write(problem)
        slot.head[TIME_BUDGET] = budget
        slot.start[:] = start
        library().hold_solve(slot.address)
        return slot.read()

    def solve_batch(
        self,
        problems: HoldProblem | Sequence[HoldProblem],
        starts: Sequence[Vector] | Vector,
        *,
        threads: int = 1,
        stop_at_first: bool = False,
        time_budget: float = float("inf"),
    ) -> BatchSolution:
        """Solve a problem from many starts, or many problems from a start each.

        Parameters
        ----------
        problems : HoldProblem or sequence of HoldProblem
            One for all starts, or one a start; their horizons may differ.
        starts : sequence of ndarray, shape (N, 2) each
            First guesses [rad/s].
        threads : int, optional
            How many threads share the work; the answers do not depend on it.
        stop_at_first : bool, optional
            Abandon what comes after the lowest index that reaches `SolverSettings.target_cost`;
            what comes before it is always finished, so the winner does not depend on the threads.
        time_budget : float, optional
            Wall time for the whole batch [s]; what is not begun by then is abandoned.

        Returns
        -------
        BatchSolution
        """
        guesses = list(starts)
        count = len(guesses)
        many = [problems] * count if isinstance(problems, HoldProblem) else list(problems)
        if len(many) != count:
            raise InvalidInputError(
                f"batch: given {len(many)} problems and {count} starts, expected as many"
            )
        if self.backend == "numpy":
            answers: BatchSolution = self._numpy.solve_batch(
                many, guesses, self.settings, stop_at_first, time_budget
            )
            return answers
        return solve_batch_compiled(
            many, guesses, self.settings, threads, stop_at_first, time_budget
        )

    def _slot(self, intervals: int) -> Slot:
        slots: dict[Any, Any] = self._slots.__dict__
        slot: Slot | None = slots.get(intervals)
        if slot is None:
            slot = Slot(intervals).own_workspace()
            slot.write_settings(self.settings)
            slots[intervals] = slot
        return slot


def expand_compiled(problem: HoldProblem, start: Vector) -> dict[str, Vector | float]:
    """Return what the compiled iteration sees at `start` [rad/s], for comparison.

    Returns
    -------
    dict
        ``cost``; ``gradient`` (2 N,) and ``hessian`` (2 N, 2 N) by scaled inputs; ``states``
        (N + 1, 6); ``sensitivities`` (N + 1, 6, 2 N) per rad/s.
    """
    n = problem.intervals
    slot = Slot(n).own_workspace()
    slot.write_settings(SolverSettings())
    slot.write(problem)
    slot.start[:] = start
    gradient, hessian = np.zeros(2 * n), np.zeros((2 * n, 2 * n))
    sensitivities = np.zeros((n + 1, 6, 2 * n))
    outputs = (array.ctypes.data for array in (gradient, hessian, sensitivities))
    library().hold_expand(slot.address, *outputs)
    found = slot.read()
    return {
        "cost": found.cost,
        "gradient": gradient,
        "hessian": hessian,
        "states": found.states,
        "sensitivities": sensitivities / problem.input_scale,
    }
