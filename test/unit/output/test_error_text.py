# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A figure that cannot be drawn is a warning of one line, and numbers are short."""

import pytest

from sphere_sim.output.error_text import draw_or_warn
from sphere_sim.output.round_numbers import grid_cell, round_down, three_digits


@pytest.mark.parametrize("error", [OSError(28, "No space left", "a.png"), ValueError("no\nfont")])
def test_figure_that_cannot_be_drawn_is_one_warning_that_names_the_file(error, caplog) -> None:
    def draw() -> None:
        raise error

    assert not draw_or_warn("study", "out/a.png", draw)
    (warning,) = caplog.messages
    assert warning.startswith("sphere_nmpc study: out/a.png not drawn: ") and "\n" not in warning


@pytest.mark.parametrize(
    ("value", "expected"),
    [(1.0, 1.0), (0.999, 0.5), (3.33, 2.0), (99.0, 50.0), (0.1 + 0.2, 0.2), (4.9999999999, 5.0)],
)
def test_numbers_are_rounded_down_to_1_2_and_5(value, expected) -> None:
    assert round_down(value) == expected


def test_grids_and_numbers_suit_fast_and_small_robots() -> None:
    assert [grid_cell(radius) for radius in (0.0365, 0.3, 1.0)] == [0.05, 0.5, 1.0]
    short = [three_digits(value) for value in (1000.0, 99.97, 0.016612)]
    assert short == ["1000", "100", "0.0166"]
