# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Foreign text in a log: one line of limited length, without control characters."""

from collections.abc import Callable

import pytest

from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.foreign_text import LONGEST, LONGEST_LINE, printable_line, shown


@pytest.mark.parametrize("function", [shown, printable_line])
@pytest.mark.parametrize(
    "text",
    [
        "world\n[FATAL] [0.0] [controller]: rotors on fire",
        "\x1b[2J\x1b[31mred",
        "\u202eright to left, \u2028 a line separator, \x9b31m and \x07",
        "\x00" * LONGEST_LINE,
    ],
)
def test_control_characters_are_escaped(function: Callable[[str], str], text: str) -> None:
    result = function(text)
    assert result.isprintable() and len(result) <= LONGEST_LINE
    assert result.splitlines() == [result]


def test_line_that_can_be_printed_stays_as_it_is_up_to_its_longest() -> None:
    line = "pose refused: frame: given 'größe', expected 'world' or none"
    assert printable_line(line) == line
    assert printable_line("x" * 200_000) == "x" * (LONGEST_LINE - 3) + "..."


def test_fault_log_writes_such_lines_only() -> None:
    lines: list[str] = []
    FaultLog(lines.append).report("worker", "given\na traceback")
    assert lines == ["worker: given\\na traceback"]


@pytest.mark.parametrize("value", ["x" * 200_000, b"\x00" * 200_000, list(range(100_000))])
def test_long_values_are_cut(value: object) -> None:
    result = shown(value)
    assert len(result) == LONGEST
    assert result.endswith("...")


def test_short_values_are_shown_as_they_are() -> None:
    assert shown("map") == "'map'"
    assert shown(1.5) == "1.5"
