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
from collections.abc import Sequence
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


class Batch:
    """Problems of one kind that are solved in one call, for one thread at a time.

    Their arrays and the workspace of a solve are kept, and grow.

    Parameters
    ----------
    solver : ctypes.CDLL
        The compiled solver.
    kind : type
        Class of the problems.

    Attributes
    ----------
    rows : list of dict of ndarray
        The members of each C structure by name; scalars have no dimension, and arrays room for
        more intervals than the problem may have.
    """

    def __init__(self, solver: ctypes.CDLL, kind: type[Problem]) -> None:
        self._solver, self._run = solver, getattr(solver, _SOLVERS[kind])
        sized, scalar = _names_of(kind)
        self._sized, self._scalar = attrgetter(*sized), attrgetter(*scalar)
        self._of_settings = attrgetter(*_names_of(SolverSettings)[1])
        self._names = (*sized, "start"), ("intervals", *scalar)
        self._count = self._longest = 0

    def _allocate(self, count: int, longest: int) -> None:
        """Make room for so many problems, of as many intervals."""
        words: Vector = np.zeros((count, SIZE))
        workspace: Vector = np.zeros(self._solver.hold_workspace(longest))
        sizes = {"N": longest, "N + 1": longest + 1}
        self.rows = [dict[str, NDArray[Any]]() for _ in range(count)]
        for row, values in zip(words, self.rows, strict=True):
            word = 0
            for member in MEMBERS:
                place = row[word : word + member.words]
                if member.c_type != "double":
                    place = place.view(np.int64)
                if member.is_pointer:
                    array = workspace  # of one solve after the other
                    if member.name != "workspace":
                        array = np.zeros([sizes.get(size, size) for size in member.shape])
                    place.view(np.int64)[0] = array.ctypes.data
                    place = array
                values[member.name] = place if member.shape else place.reshape(())
                word += member.words
        self._count, self._longest, self._address = count, longest, words.ctypes.data
        settings = (*_names_of(SolverSettings)[1], "time_budget")
        # An assignment to an array that is kept takes a tenth of a microsecond or less.
        self._places = [
            [[row[name] for name in names]
             for names in (*self._names, settings, *_names_of(Solution))]
            for row in self.rows
        ]

    def solve(
        self, problems: Sequence[Problem], starts: Sequence[Vector], settings: SolverSettings,
        time_budget: float,
    ) -> list[Solution]:
        """Solve problems; the arguments are those of `sphere_nmpc.solver.solve.solve_all`."""
        sizes = [problem.durations.size for problem in problems]
        longest, tuning = max(sizes), (*self._of_settings(settings), time_budget)
        if len(sizes) > self._count or longest > self._longest:
            self._allocate(max(len(sizes), self._count), max(longest, self._longest))
        for problem, start, n, places in zip(problems, starts, sizes, self._places, strict=False):
            sized, scalars, of_settings, _, _ = places
            for array, values in zip(sized, (*self._sized(problem), start), strict=True):
                array[:n] = values
            given = (n, *self._scalar(problem), *tuning)
            for place, value in zip((*scalars, *of_settings), given, strict=True):
                place[...] = value
        self._run(len(sizes), self._address)
        found = list[Solution]()
        for problem, n, (*_, sized, scalars) in zip(problems, sizes, self._places, strict=False):
            (inputs, states, _), (cost, status, *others) = sized, [s.item() for s in scalars]
            found.append(Solution(
                inputs[: n + 1].copy(), states[: n + 1].copy(), problem.durations, cost,
                STATUSES[status], *others,
            ))
        return found


def _names_of(record: type) -> tuple[list[str], list[str]]:
    """Return the fields of a record that are arrays with room for N intervals, and the others."""
    is_sized = {member.name: member.is_pointer for member in MEMBERS}
    names = [field.name for field in fields(record)]
    return [n for n in names if is_sized[n]], [n for n in names if not is_sized[n]]
