# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Layout of the C structure ``problem``, which Python fills and the compiled solver reads.

This is the only place that names its fields. Every field is made of words of eight bytes, so the
structure is a row of doubles in which integers and pointers are read through an integer view of
the same bytes. The C declaration is generated from the table, with its check sum: a binary of
another layout is not used.
"""

import zlib
from typing import NamedTuple

from sphere_nmpc.solver.problem import SolveStatus

WORD = 8
"""Bytes of a double, of an ``int64_t`` and of a pointer."""

STATUSES = (
    SolveStatus.CONVERGED,
    SolveStatus.CAPPED,
    SolveStatus.BUDGET,
    SolveStatus.NOT_FINITE,
    SolveStatus.STALLED,
)
"""Statuses by the number that the compiled solver writes."""


class Field(NamedTuple):
    """A member of the structure: its C type, name, number of words and meaning."""

    c_type: str
    name: str
    words: int
    meaning: str


FIELDS = (
    Field("double", "state", 9, "x_0"),
    Field("double", "goal", 6, "x_d"),
    Field("double", "input_in_force", 2, "u_0 [rad/s]"),
    Field("double", "constants", 4, "Rs, c1, r1, r3"),
    Field("double", "torques", 5, "s and a [rad/s^2]"),
    Field("double", "input_reference", 2, "u_ref [rad/s]"),
    Field("double", "momentum_row", 3, "r_h [s/rad]"),
    Field("double", "steady_axis", 2, "a"),
    Field("double", "turn_weights", 3, "w_q"),
    Field("double", "goal_velocity", 2, "v_d [m/s]"),
    Field("double", "input_scale", 1, "U [rad/s]"),
    Field("double", "terminal_weight", 1, "w_T"),
    Field("double", "stage_weight", 1, "w_x"),
    Field("double", "input_weight", 1, "w_u"),
    Field("double", "slew_weight", 1, "w_s"),
    Field("double", "max_acceleration", 1, "a [rad/s^2]"),
    Field("double", "max_step", 1, "longest integration step [s]"),
    Field("double", "position_scale", 1, "s [1/m]"),
    Field("double", "whole_turns", 1, "time of whole turns [s]"),
    Field("double", "error_weight", 1, "w [s]"),
    Field("double", "gradient_tolerance", 1, "see SolverSettings"),
    Field("double", "decrease_tolerance", 1, ""),
    Field("double", "time_budget", 1, "[s]"),
    Field("double", "target_cost", 1, ""),
    Field("double", "decrease_floor", 1, ""),
    Field("double", "initial_damping", 1, ""),
    Field("double", "stretch", 1, "factor on the durations; result, as are the next three"),
    Field("double", "cost", 1, ""),
    Field("double", "kkt_residual", 1, ""),
    Field("double", "solve_time", 1, "[s]"),
    Field("int64_t", "intervals", 1, "N"),
    Field("int64_t", "max_iterations", 1, ""),
    Field("int64_t", "status", 1, "result, as is the next one"),
    Field("int64_t", "iterations", 1, ""),
    Field("int64_t", "steady_interval", 1, "that of steady rolling; 0 without"),
    Field("int64_t", "disturbed", 1, "whether there are momentum or torques; result"),
    Field("const double *", "durations", 1, "N [s]"),
    Field("const double *", "lower", 1, "N x 2 [rad/s]"),
    Field("const double *", "upper", 1, "N x 2 [rad/s]"),
    Field("const double *", "start", 1, "N x 2 [rad/s], the initial guess"),
    Field("double *", "inputs", 1, "(N + 1) x 2 [rad/s], result"),
    Field("double *", "states", 1, "(N + 1) x 9, result"),
    Field("double *", "workspace", 1, "hold_workspace(N) doubles"),
)

SIZE = sum(field.words for field in FIELDS)
"""Words of the structure."""


def index(name: str) -> int:
    """Return the word at which a field begins."""
    names = [field.name for field in FIELDS]
    return sum(field.words for field in FIELDS[: names.index(name)])


def span(first: str, last: str | None = None) -> slice:
    """Return the words of a field, or of all fields from `first` to `last`."""
    end = last or first
    (words,) = (field.words for field in FIELDS if field.name == end)
    return slice(index(first), index(end) + words)


def problem_header() -> str:
    """Return the C header ``problem.h``: the structure and the numbers of the statuses."""
    return f"{_declarations()}#define LAYOUT {check_sum()}\n"


def check_sum() -> int:
    """Return a number that differs for another layout; the binary exports its own."""
    return zlib.crc32(_declarations().encode())


def _declarations() -> str:
    lines = ["typedef struct {"]
    for field in FIELDS:
        array = f"[{field.words}]" if field.words > 1 else ""
        space = "" if field.c_type.endswith("*") else " "
        comment = f" /* {field.meaning} */" if field.meaning else ""
        lines.append(f"    {field.c_type}{space}{field.name}{array};{comment}")
    lines.append("} problem;")
    text = '"layout.py assumes words of eight bytes"'
    lines.append(f"_Static_assert(sizeof(problem) == {WORD * SIZE}, {text});")
    lines.append(f"enum {{ {', '.join(status.name for status in STATUSES)} }};")
    return "\n".join(lines) + "\n"
