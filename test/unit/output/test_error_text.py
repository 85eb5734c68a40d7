# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A figure that cannot be drawn is a warning of one line, and numbers are short."""

import math

import pytest

from sphere_sim.output.error_text import draw_or_warn
from sphere_sim.output.round_numbers import grid_cell, length, round_down, three_digits


@pytest.mark.parametrize("error", [OSError(28, "No space left", "a.png"), ValueError("no\nfont")])
def test_figure_that_cannot_be_drawn_is_one_warning_that_names_the_file(error, caplog) -> None:
    def draw() -> None:
        raise error

    assert not draw_or_warn("study", "out/a.png", draw)
    (warning,) = caplog.messages
    assert warning.startswith("sphere_nmpc study: out/a.png not drawn: ") and "\n" not in warning


@pytest.mark.parametrize(
    ("rounded", "cases"),
    [
        (round_down, {1.0: 1.0, 0.999: 0.5, 3.33: 2.0, 99.0: 50.0, 0.1 + 0.2: 0.2,
                      4.9999999999: 5.0}),
        (grid_cell, {0.0365: 0.05, 0.3: 0.5, 1.0: 1.0}),  # of a radius
        (three_digits, {1000.0: "1000", 99.97: "100", 0.016612: "0.0166"}),
        (length, {5e-6: "0.005 mm", 0.0: "0 mm", -0.1: "-100 mm", 0.9994: "999 mm",
                  0.9996: "1 m", 141.4: "141 m", math.nan: "nan mm"}),
    ],
)
def test_numbers_are_short(rounded, cases) -> None:
    assert {value: rounded(value) for value in cases} == cases
