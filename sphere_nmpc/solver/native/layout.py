# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Layout of the C structure ``problem``, which Python fills and the compiled solver reads.

Its members are the fields of the problems, the settings and the solution, in this order; those of
the other problem stay zero. Each is made of words of eight bytes, so the structure is a row of
doubles in which integers and pointers are read through an integer view of the same bytes. The C
declaration is generated with a check sum of it and of the arguments of all functions: a binary of
another layout is not used.
"""

import ctypes
import zlib
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, get_type_hints

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.problem import (
    End,
    LeastSquaresProblem,
    MinimumTimeProblem,
    Solution,
    SolverSettings,
    SolveStatus,
)

STATUSES = tuple(SolveStatus)
"""Statuses by the number that the compiled solver writes."""

_ADDRESS, _COUNT, _NUMBER = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
_KINDS = {_ADDRESS: "address", _COUNT: "count", _NUMBER: "number", None: "nothing"}
FUNCTIONS: dict[str, tuple[Any, ...]] = {
    "solve_least_squares": (None, _COUNT, _ADDRESS),
    "solve_minimum_time": (None, _COUNT, _ADDRESS),
    "hold_roll_out": (None, _COUNT, _NUMBER, *[_ADDRESS] * 5),
    "hold_propagate": (None, _COUNT, _NUMBER, *[_ADDRESS] * 6),
    "hold_half_motions": (None, _COUNT, _COUNT, *[_NUMBER] * 3, *[_ADDRESS] * 6),
    "hold_workspace": (_COUNT, _COUNT),
    "hold_meet": (_COUNT, *[_COUNT] * 4, *[_NUMBER] * 3, *[_ADDRESS] * 10),
    "hold_way": (None, *[_COUNT] * 3, *[_ADDRESS] * 5),
    "hold_end_before_collisions": (
        None, _COUNT, _COUNT, _ADDRESS, _ADDRESS, _COUNT, _COUNT, _ADDRESS, _NUMBER, _ADDRESS,
    ),
    "hold_clearance": (
        _NUMBER, _COUNT, *[_ADDRESS] * 6, _COUNT, _COUNT, _ADDRESS, *[_NUMBER] * 4, _ADDRESS,
        _COUNT,
    ),
    "hold_along_path": (
        _COUNT, _COUNT, *[_NUMBER] * 5, *[_ADDRESS] * 5, _COUNT, _ADDRESS, _ADDRESS,
    ),
}
"""Functions of the compiled solver: types of the result and of the arguments."""


@dataclass
class Call:
    """What else a call of the compiled solver needs."""

    intervals: int
    time_budget: float
    start: Annotated[Vector, "N", 2]
    """The initial guess [rad/s]."""
    disturbed: int
    """Whether there are momentum or torques, which the solver finds out."""
    workspace: Annotated[Vector, "workspace"]


class Member(NamedTuple):
    """A member of the structure; arrays whose shape depends on N are somewhere else."""

    c_type: str
    name: str
    shape: tuple[Any, ...]

    @property
    def is_pointer(self) -> bool:
        """Whether the structure has the address of an array in its place."""
        return self.shape != () and isinstance(self.shape[0], str)

    @property
    def words(self) -> int:
        """Return the number of words in the structure."""
        return 1 if self.is_pointer or not self.shape else int(self.shape[0])


def _members() -> tuple[Member, ...]:
    found = {}
    for record in (LeastSquaresProblem, MinimumTimeProblem, SolverSettings, Solution, Call):
        for name, hint in get_type_hints(record, include_extras=True).items():
            shape = getattr(hint, "__metadata__", ())
            found[name] = Member("double" if shape or hint is float else "int64_t", name, shape)
    return tuple(found.values())


MEMBERS = _members()
SIZE = sum(member.words for member in MEMBERS)
"""Words of the structure."""


def problem_declaration() -> str:
    """Return the C declaration of the structure and of the numbers of statuses and ends."""
    return f"{_declarations()}#define LAYOUT {check_sum()}\n"


def check_sum() -> int:
    """Return a number that differs for another interface; the binary exports its own."""
    functions = (
        " ".join((name, *(_KINDS[kind] for kind in kinds))) for name, kinds in FUNCTIONS.items()
    )
    return zlib.crc32("\n".join((_declarations(), *functions)).encode())


def _declarations() -> str:
    lines = ["typedef struct {"]
    for member in MEMBERS:
        pointer = "*" if member.is_pointer else ""
        array = f"[{member.words}]" if member.words > 1 else ""
        lines.append(f"    {member.c_type} {pointer}{member.name}{array};")
    lines.append("} problem;")
    lines.append(f'_Static_assert(sizeof(problem) == {8 * SIZE}, "words of eight bytes");')
    lines.append(f"enum {{ {', '.join(status.name for status in STATUSES)} }};")
    lines.append(f"enum {{ {', '.join(f'END_{end.name} = {end:d}' for end in End)} }};")
    return "\n".join(lines) + "\n"
