# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled solver, which ``setup.py`` builds at the installation, and memory shared with it.

Problems are written to the C structure ``problem`` through NumPy views that are kept: several
times faster than assigning to the members of a `ctypes.Structure`.
"""

import ctypes
import logging
import os
import struct
from dataclasses import fields
from functools import cache
from importlib.util import find_spec
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.native.layout import FUNCTIONS, MEMBERS, SIZE, STATUSES, check_sum
from sphere_nmpc.solver.problem import (
    LeastSquaresProblem,
    MinimumTimeProblem,
    Problem,
    Solution,
    SolverSettings,
)

FOLDER = Path(__file__).parent
VARIABLE = "SPHERE_NMPC_SOLVER"
"""Environment variable; with the value ``plain`` the compiled solver is not used."""

_SOLVERS = {
    LeastSquaresProblem: "solve_least_squares", MinimumTimeProblem: "solve_minimum_time",
}
"""Function of the compiled solver for each problem."""
_ELF = struct.Struct("<40xQ10xHH2x")
"""Header of a library of Linux on a machine of 64 bits: where its last part, the table of its
sections, begins, the length of a row of it, and the number of rows."""

_log = logging.getLogger("sphere_nmpc")


class MissingSolverError(SphereNmpcError):
    """The compiled solver cannot be used, and CasADi, for the plain one, is not installed."""


@cache
def library() -> ctypes.CDLL | None:
    """Return the compiled solver; None, with one warning a process, where it cannot be used.

    `sphere_nmpc.solver.plain` then takes its place, or `MissingSolverError` is raised.
    """
    try:
        return _loaded()
    except OSError as cause:
        if find_spec("casadi") is None:
            raise MissingSolverError(
                f"the compiled solver cannot be used ({cause}), and the plain one needs CasADi: "
                "install the package again with a C compiler (in a checkout: make venv), or casadi"
            ) from None
        _log.warning(
            "sphere_nmpc: the compiled solver is not used (%s); a plain one takes its place, with "
            "the same results in about 300 times the time. To cure this, install the "
            "package again with a C compiler (in a checkout: make venv)", cause,
        )
        return None


def _loaded() -> ctypes.CDLL:
    if os.environ.get(VARIABLE) == "plain":
        raise OSError(f"{VARIABLE}=plain")
    solver = _opened(FOLDER / "solver.so")
    try:
        solver.hold_level.restype = ctypes.c_char_p
        # The same for the instruction set of this processor.
        fitting = FOLDER / f"solver{solver.hold_level().decode()}.so"
        if fitting.exists():
            solver = _opened(fitting)
        is_current = ctypes.c_int64.in_dll(solver, "hold_layout").value == check_sum()
        if is_current:
            for name, (result, *arguments) in FUNCTIONS.items():
                function = getattr(solver, name)
                function.argtypes, function.restype = arguments, result
    except (AttributeError, ValueError):  # a name that it does not have
        is_current = False
    if not is_current:
        raise OSError(f"{solver._name} is of another version of the package")
    return solver


def _opened(path: Path) -> ctypes.CDLL:
    """Open a library; where the end of it is missing, its use would end the process."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(_ELF.size)
    if header[:4] == b"\x7fELF" and len(header) == _ELF.size:
        begin, length, number = _ELF.unpack(header)
        expected = begin + length * number
        if size < expected:
            raise OSError(f"{path} is cut off, given {size} bytes, expected {expected}")
    return ctypes.CDLL(str(path))


class Slot:
    """One problem with its arrays and the workspace of its solve; for one thread at a time.

    Parameters
    ----------
    solver : ctypes.CDLL
        The compiled solver.
    kind : type
        Class of the problem.
    intervals : int
        N.

    Attributes
    ----------
    values : dict of ndarray
        The members of the C structure by name; scalars have no dimension.
    """

    def __init__(self, solver: ctypes.CDLL, kind: type[Problem], intervals: int) -> None:
        words: Vector = np.zeros(SIZE)
        sizes = {
            "N": intervals, "N + 1": intervals + 1,
            "workspace": solver.hold_workspace(intervals),
        }
        self.values: dict[str, NDArray[Any]] = {}
        word = 0
        for member in MEMBERS:
            row = words if member.c_type == "double" else words.view(np.int64)
            place = row[word : word + member.words]
            if member.is_pointer:
                array: Vector = np.zeros([sizes.get(size, size) for size in member.shape])
                place.view(np.int64)[0] = array.ctypes.data
                place = array
            self.values[member.name] = place if member.shape else place.reshape(())
            word += member.words
        self.values["intervals"][...] = intervals
        self._run, self._address = getattr(solver, _SOLVERS[kind]), words.ctypes.data
        # An assignment to a whole array that is kept takes a tenth of a microsecond or less.
        of_problem, of_settings, found = map(_names_of, (kind, SolverSettings, Solution))
        self._of_problem, self._of_settings = attrgetter(*of_problem), attrgetter(*of_settings)
        given = (*of_problem, *of_settings, "start", "time_budget")
        self._given, self._found = ([self.values[n] for n in names] for names in (given, found))

    def solve(
        self, problem: Problem, start: Vector, settings: SolverSettings, time_budget: float
    ) -> Solution:
        """Solve a problem; the arguments are those of `sphere_nmpc.solver.solve.solve`."""
        values = (*self._of_problem(problem), *self._of_settings(settings), start, time_budget)
        for place, value in zip(self._given, values, strict=True):
            place[...] = value
        self._run(self._address)
        inputs, states, durations, *scalars = self._found
        cost, status, *others = [place.item() for place in scalars]
        return Solution(
            inputs.copy(), states.copy(), durations.copy(), cost, STATUSES[status], *others
        )


def _names_of(record: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(record))
