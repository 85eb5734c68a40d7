# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
import pytest

from sphere_sim.output.round_numbers import grid_cell, round_down, three_digits


@pytest.mark.parametrize(
    ("value", "expected"),
    [(1.0, 1.0), (0.999, 0.5), (0.1217, 0.1), (3.33, 2.0), (99.0, 50.0), (0.003, 0.002),
     (10.0 * 0.3 / 3.0, 1.0), (0.1 + 0.2, 0.2), (4.9999999999, 5.0)],
)
def test_numbers_are_rounded_down_to_1_2_and_5(value, expected) -> None:
    assert round_down(value) == expected


def test_grid_is_that_of_half_a_metre_for_the_robot_of_the_paper() -> None:
    assert [grid_cell(radius) for radius in (0.0365, 0.3, 1.0)] == [0.05, 0.5, 1.0]


@pytest.mark.parametrize(
    ("value", "text"), [(1000.0, "1000"), (99.97, "100"), (0.016612, "0.0166"), (2.46, "2.46")]
)
def test_numbers_of_fast_and_of_small_robots_are_short(value, text) -> None:
    assert three_digits(value) == text
