# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Solver of `HoldProblem`, compiled where possible and on NumPy otherwise."""

import threading
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.backend import resolve_backend
from sphere_nmpc.solver.native.memory import Slot, library
from sphere_nmpc.solver.problem import HoldProblem, HoldSolution, SolverSettings

_NUMPY_SOLVER = "sphere_nmpc.solver.numpy_backend.levenberg_marquardt"


class HoldSolver:
    """Solver with fixed stopping rules; safe to call from several threads.

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
        # Loaded only where it is needed, as SciPy takes a third of a node's start; and now rather
        # than within the first solve.
        self._numpy: Any = import_module(_NUMPY_SOLVER) if self.backend == "numpy" else None

    def solve(
        self, problem: HoldProblem, start: Vector, time_budget: float | None = None
    ) -> HoldSolution:
        """Solve a problem from an initial guess.

        Parameters
        ----------
        problem : HoldProblem
            The problem.
        start : ndarray, shape (N, 2)
            Initial guess of the knots u_1 ... u_N [rad/s]; clipped to the bounds.
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
            solution: HoldSolution = self._numpy.minimise(problem, start, limited)
            return solution
        slot = self._slot(problem.durations.size)
        slot.write(problem, start, budget)
        library().hold_solve(slot.address)
        return slot.read()

    def _slot(self, intervals: int) -> Slot:
        slots: dict[Any, Any] = self._slots.__dict__
        slot: Slot | None = slots.get(intervals)
        if slot is None:
            slot = Slot(intervals)
            slot.write_settings(self.settings)
            slots[intervals] = slot
        return slot


def expand_compiled(problem: HoldProblem, start: Vector) -> dict[str, Vector | float]:
    """Return the quadratic model of the compiled solver at `start` [rad/s], for tests.

    Returns
    -------
    dict
        ``cost``; ``gradient`` (2 N,) and ``hessian`` (2 N, 2 N) by scaled inputs; ``states``
        (N + 1, 6); ``sensitivities`` (N + 1, 6, 2 N) per rad/s.
    """
    n = problem.intervals
    slot = Slot(n)
    slot.write_settings(SolverSettings())
    slot.write(problem, start, np.inf)
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
