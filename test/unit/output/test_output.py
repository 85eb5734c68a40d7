# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Outlines of floors, short numbers, and one warning where no figure can be drawn."""

import math

import numpy as np
import pytest

from sphere_nmpc.floor.occupancy import Grid
from sphere_sim.output.error_text import draw_or_warn
from sphere_sim.output.floor_shapes import bordered, cropped, outlines
from sphere_sim.output.round_numbers import grid_cell, length, round_down, three_digits

ORIGIN = (3.0, -2.0, 0.4)


def covered(grid: Grid) -> np.ndarray:
    """Return how many outlines are on each cell of a grid."""
    count = np.zeros(grid.occupied.shape, dtype=int)
    for local in np.round(grid.local(outlines(grid)), 6):
        a, b, c, d = local
        # Anticlockwise from the corner at the lower left.
        assert a[0] == d[0] < b[0] == c[0] and a[1] == b[1] < c[1] == d[1]
        count[int(a[1]) : int(c[1]), int(a[0]) : int(c[0])] += 1
    return count


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 1.0])
def test_outlines_cover_occupied_cells_once_and_no_others(share) -> None:
    cells = np.random.default_rng(1).random((30, 50)) < share
    np.testing.assert_array_equal(covered(Grid(cells, 0.05, ORIGIN)), cells)
    # Blocks and long walls are single outlines.
    cells = np.zeros((20, 30), dtype=bool)
    cells[2:9, 3:7] = cells[:, 20] = True
    assert len(outlines(Grid(cells, 0.05, ORIGIN))) == 2


def test_large_maps_are_drawn_coarser_but_nothing_occupied_is_missing() -> None:
    rng = np.random.default_rng(1)
    places = rng.integers(0, 4000, (3000, 2))
    cells = np.zeros((4000, 4000), dtype=bool)
    cells[places[:, 0], places[:, 1]] = True
    grid = Grid(cells, 0.05, ORIGIN)
    found = grid.local(outlines(grid))
    assert 0 < len(found) <= 4000
    low, high = found.min(axis=1), found.max(axis=1)
    middles = places[:, ::-1] + 0.5
    is_in = (low[:, None] < middles) & (middles < high[:, None])
    assert is_in.all(axis=2).any(axis=0).all()


def test_border_is_one_cell_around_the_grid_and_boxes_are_cut_out_of_it() -> None:
    grid = Grid(np.zeros((4, 6), dtype=bool), 0.5, ORIGIN)
    around = bordered(grid)
    assert around.occupied.shape == (6, 8) and not around.occupied[1:-1, 1:-1].any()
    assert around.occupied.sum() == 48 - 24
    np.testing.assert_allclose(around.local(grid.world(np.array([2.5, 3.5]))), [3.5, 4.5])
    place = grid.world(np.array([0.5, 1.5]))
    part = cropped(around, place - 0.1, place + 0.1)
    assert part.occupied.size < 9
    column, row = np.floor(part.local(place)).astype(int)
    assert not part.occupied[row, column]
    np.testing.assert_allclose(part.world(part.local(place)), place)
    assert cropped(around, place + 50.0, place + 51.0) is None


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
