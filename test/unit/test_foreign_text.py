# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Foreign text in a log: one line of limited length, without control characters."""

import pytest

from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.foreign_text import LONGEST, LONGEST_LINE, printable_line, shown


@pytest.mark.parametrize(
    "text",
    [
        "world\n[FATAL] [0.0] [controller]: rotors on fire",
        "\x1b[2J\x1b[31mred",
        "\u202eright to left, \u2028 a line separator, \x9b31m and \x07",
        "\x00" * 200_000,
    ],
)
def test_control_characters_are_escaped_and_long_texts_cut(text: str) -> None:
    lines: list[str] = []
    FaultLog(lines.append).report("worker", text)
    for result, longest in ((shown(text), LONGEST), (lines[0], LONGEST_LINE)):
        assert result.isprintable() and len(result) <= longest
        assert result.splitlines() == [result]


def test_line_that_can_be_printed_stays_as_it_is() -> None:
    line = "pose refused: frame: given 'größe', expected 'world' or none"
    assert printable_line(line) == line
