# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Foreign text in a log: one line of limited length, without control characters."""

import pytest

from sphere_nmpc.foreign_text import LONGEST, shown


@pytest.mark.parametrize(
    "text",
    [
        "world\n[FATAL] [0.0] [controller]: rotors on fire",
        "\x1b[2J\x1b[31mred",
        "\u202eright to left, \u2028 a line separator, \x9b31m and \x07",
    ],
)
def test_control_characters_are_escaped(text: str) -> None:
    result = shown(text)
    assert result.isprintable()
    assert result.splitlines() == [result]


@pytest.mark.parametrize("value", ["x" * 200_000, b"\x00" * 200_000, list(range(100_000))])
def test_long_values_are_cut(value: object) -> None:
    result = shown(value)
    assert len(result) == LONGEST
    assert result.endswith("...")


def test_short_values_are_shown_as_they_are() -> None:
    assert shown("map") == "'map'"
    assert shown(1.5) == "1.5"
