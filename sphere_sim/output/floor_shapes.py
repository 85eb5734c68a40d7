# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Outlines of what is occupied on a floor, few enough to be drawn whatever the size of a map is.

What is outside of a grid is occupied: it is drawn as a border around the grid.
"""

import math

import numpy as np

from sphere_nmpc.floor.occupancy import Cells, Grid
from sphere_nmpc.floor.rectangles import rectangles
from sphere_nmpc.model.state import Vector

_MOST_CELLS = 1000
"""Cells along the longer side of a grid that is drawn; larger ones are drawn in coarser cells."""
_MOST_RECTANGLES = 4000
"""Rectangles of a grid that is drawn; one that needs more is drawn in coarser cells."""


def bordered(grid: Grid) -> Grid:
    """Return a grid with one more cell around it, which is occupied."""
    x, y = grid.world(np.array([-1.0, -1.0]))
    cells = np.pad(grid.occupied, 1, constant_values=True)
    return Grid(cells, grid.resolution, (float(x), float(y), grid.origin[2]))


def cropped(grid: Grid, low: Vector, high: Vector) -> Grid | None:
    """Return the part of a grid that covers a box from `low` to `high`, shapes (2,) [m].

    The box is along the axes of the world; None where it is beside the grid.
    """
    height, width = grid.occupied.shape
    box = grid.local(np.array([low, high, (low[0], high[1]), (high[0], low[1])]))
    j0, i0 = np.clip(np.floor(box.min(axis=0)), 0, (width, height)).astype(int)
    j1, i1 = np.clip(np.ceil(box.max(axis=0)), 0, (width, height)).astype(int)
    if i0 >= i1 or j0 >= j1:
        return None
    x, y = grid.world(np.array([j0, i0], dtype=float))
    return Grid(grid.occupied[i0:i1, j0:j1], grid.resolution, (float(x), float(y), grid.origin[2]))


def outlines(grid: Grid) -> Vector:
    """Return rectangles that cover the occupied cells of a grid and nothing else.

    In a grid that is too fine or has too many of them, free cells beside occupied ones are
    covered as well.

    Returns
    -------
    ndarray, shape (n, 4, 2)
        Their corners, anticlockwise [m; world frame].
    """
    factor = max(1, math.ceil(max(grid.occupied.shape) / _MOST_CELLS))
    while True:
        cells = _coarser(grid.occupied, factor)
        found = rectangles(cells)
        if len(found) <= _MOST_RECTANGLES:
            break
        factor *= 2
    corners = factor * found[:, [0, 1, 2, 1, 2, 3, 0, 3]].reshape(-1, 4, 2).astype(float)
    return grid.world(corners)


def _coarser(cells: Cells, factor: int) -> Cells:
    """Return cells of `factor` times the side, occupied where any cell in them is."""
    if factor == 1:
        return cells
    rows, columns = (-size % factor for size in cells.shape)
    padded = np.pad(cells, ((0, rows), (0, columns)))
    height, width = padded.shape
    blocks = padded.reshape(height // factor, factor, width // factor, factor)
    return np.logical_or.reduce(blocks, axis=(1, 3))
