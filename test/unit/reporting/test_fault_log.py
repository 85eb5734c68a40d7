# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults are logged at a limited rate, all of them counted, and foreign text in one line."""

import numpy as np
import pytest

from sphere_nmpc.errors import LONGEST, LONGEST_LINE, Description, printable_line, shown
from sphere_nmpc.reporting.fault_log import FaultLog, LastingFaults


def test_descriptions_are_shown_as_they_are_and_long_values_cut() -> None:
    assert len(shown(list(np.zeros(10**5)))) == LONGEST
    assert shown(Description("no such file")) == "no such file"
    assert shown(Description("a\x1b[31m\n")) == "a\\x1b[31m\\n"
    assert len(shown(Description("a" * 1000))) == LONGEST


def test_fault_is_logged_immediately_then_with_a_count() -> None:
    lines: list[str] = []
    now = [0.0]
    faults = FaultLog(lines.append, period=5.0, clock=lambda: now[0])
    for now[0] in (0.0, 0.1, 4.9):
        faults.report("pose refused", "given nan")
    assert lines == ["pose refused: given nan"]
    faults.report("goal refused", "given map")
    assert lines[1:] == ["goal refused: given map"]
    now[0] = 5.0
    faults.report("pose refused", "given inf")
    assert lines[2:] == ["pose refused: given inf (2 more since the last message)"]
    assert faults.counts == {"pose refused": 4, "goal refused": 1}


def test_fault_that_comes_and_goes_begins_once_and_is_over_once() -> None:
    lines: list[str] = []
    now = [0.0]
    lasting = LastingFaults(FaultLog(lines.append, clock=lambda: now[0]), lines.append)
    for number in range(100):
        now[0] = 0.25 * number
        lasting.update({"wrong clock": "5 s behind"} if number % 3 == 0 else {})
    assert lines == ["wrong clock: 5 s behind"]
    for now[0] in (29.5, 29.75, 30.0):
        lasting.update({})
    assert lines[1:] == ["wrong clock: over"]
    lasting.update({"wrong clock": "7 s behind", "no pose": "none"})
    assert lines[2:] == ["wrong clock: 7 s behind", "no pose: none"]


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


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.float64("nan"), "nan"), ([np.float64(1.5), np.int64(2)], "[1.5, 2]"),
        ((np.True_, np.str_("a")), "(True, 'a')"), ({"x": np.float32(0.5)}, "{'x': 0.5}"),
        (np.zeros((2, 2)), "array([[0., 0.], [0., 0.]])"), ("np.float64(1)", "'np.float64(1)'"),
    ],
)
def test_values_of_numpy_are_shown_as_plain_ones_in_one_line(value: object, text: str) -> None:
    assert shown(value) == text


def test_line_that_can_be_printed_stays_as_it_is() -> None:
    line = "pose refused: frame: given 'größe', expected 'world' or none"
    assert printable_line(line) == line
