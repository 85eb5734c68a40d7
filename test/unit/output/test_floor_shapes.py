# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Outlines of a floor cover what is occupied, whatever the size of the map is."""

import numpy as np
import pytest

from sphere_nmpc.floor.occupancy import Grid
from sphere_sim.output.floor_shapes import bordered, cropped, outlines

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
