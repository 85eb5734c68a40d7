# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Walls of a simulated floor: what the map has as occupied, and whether the sphere touches it.

Occupied cells are merged into rectangles, which are the boxes of the plant with contact, and from
which the distance of the ideal one is exact. What is outside of the grid is a wall, too.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.floor.occupancy import Cells, Grid
from sphere_nmpc.floor.rectangles import rectangles
from sphere_nmpc.model.state import Vector

_OUTER = 1.0
"""Thickness of the walls around the grid [m]."""
_APART = 1e-3
"""Clearance gained since a contact began from which on the sphere is free again [m]: it may bounce
by less."""
_BLOCK = 64
"""Places whose distances are computed together: of a path, these are near each other."""

Rectangles = NDArray[np.intp]
"""Bounds x0, y0, x1, y1 of rectangles in the axes of a grid [cells], shape (K, 4)."""


@dataclass(frozen=True, eq=False)
class Walls:
    """Walls where a grid is occupied, and around it.

    Attributes
    ----------
    grid : Grid
        Occupied cells.
    """

    grid: Grid

    @cached_property
    def rectangles(self) -> Rectangles:
        """Bounds of rectangles of all that can be touched, the grid's surroundings included."""
        height, width = self.grid.occupied.shape
        thick = math.ceil(_OUTER / self.grid.resolution)
        around = [
            (-thick, -thick, 0, height + thick), (width, -thick, width + thick, height + thick),
            (0, -thick, width, 0), (0, height, width, height + thick),
        ]
        return np.vstack((touchable_rectangles(self.grid.occupied), around)).astype(np.intp)

    def distances(self, places: Vector) -> Vector:
        """Return the exact distances of places, shape (P, 2), to the walls [m]; 0 inside them."""
        occupied = self.grid.occupied
        local = self.grid.local(places)
        free = np.flatnonzero(((local >= 0.0) & (local < occupied.shape[::-1])).all(axis=1))
        columns, rows = local[free].astype(np.intp).T
        free = free[~occupied[rows, columns]]
        found = np.zeros(len(local))
        low, high = self.rectangles[:, :2], self.rectangles[:, 2:]
        for i in range(0, free.size, _BLOCK):
            block = local[free[i : i + _BLOCK]]
            middle = block.mean(axis=0, keepdims=True)
            reach = float(np.max(np.linalg.norm(block - middle, axis=1)))
            away = _distances(middle, low, high)[0]
            # Those that are farther from the middle are nearest to none of these places.
            near = away <= away.min() + 2.0 * reach + 1e-6
            least = _distances(block, low[near], high[near]).min(axis=1)
            found[free[i : i + _BLOCK]] = self.grid.resolution * least
        return found


def walls_of(grid: Grid, _settings: object = None) -> Walls:
    """Return the walls of a floor, with what takes long to compute."""
    walls = Walls(grid)
    walls.rectangles  # noqa: B018  computed now, and kept
    return walls


class Contact:
    """Contact of a sphere with walls: whether there is one now, and how many there have been.

    Parameters
    ----------
    walls : Walls or None
        The walls; None where there are none.
    radius : float
        Radius of the sphere [m].
    """

    def __init__(self, walls: Walls | None, radius: float) -> None:
        self.touches = 0
        """Number of contacts; a new one begins only after the sphere had been free."""
        self.is_touching = False
        """Whether a contact lasts."""
        self._radius = radius
        self._apart = _APART
        self.surround(walls)

    def surround(self, walls: Walls | None) -> None:
        """Replace the walls."""
        self.walls = walls
        # Place of the last measurement [m], and the clearance there [m].
        self._measured: Sequence[float] = (0.0, 0.0)
        self._free = -math.inf

    def least_clearance(self, places: Vector) -> float:
        """Return the least distance between sphere and walls [m] at places, shape (P, 2).

        It is negative where the sphere is in a wall, and infinite where there are none.
        """
        if self.walls is None:
            return math.inf
        return float(np.min(self.walls.distances(places))) - self._radius

    def is_into_wall(self, before: Sequence[float], after: Sequence[float]) -> bool:
        """Take a motion between two places [m]; return whether it leads into a wall.

        It does where the sphere is in the wall afterwards and no farther from its surface.
        """
        if self.walls is None:
            self.is_touching = False
            return False
        if math.dist(after, self._measured) < self._free - self._apart:
            self.is_touching = False
            return False
        clearance = self.least_clearance(np.array([after]))
        self._measured, self._free = after, clearance
        if clearance >= 0.0:
            self.is_touching = self.is_touching and clearance <= self._apart
            return False
        left = self.least_clearance(np.array([before]))
        if not self.is_touching:
            self.is_touching = True
            self.touches += 1
            self._apart = max(0.0, left) + _APART
        return not clearance > left


def _distances(places: Vector, low: Rectangles, high: Rectangles) -> Vector:
    """Return the distances of places, shape (P, 2), to K rectangles, shape (P, K) [cells]."""
    centre = places[:, None, :]
    away = np.maximum(np.maximum(low - centre, centre - high), 0.0)
    found: Vector = np.sqrt(np.einsum("pki,pki->pk", away, away))
    return found


def touchable_rectangles(occupied: Cells) -> Rectangles:
    """Return disjoint rectangles of all occupied cells, shape (H, W), that have a free neighbour.

    They cover occupied cells alone, not each that lies in the middle of others.
    """
    rows, columns = rectangles(occupied), rectangles(occupied.T)[:, [1, 0, 3, 2]]
    found = rows if len(rows) <= len(columns) else columns
    # The number of touchable cells in each, from sums over all cells below and to the left.
    sums = np.zeros((occupied.shape[0] + 1, occupied.shape[1] + 1), dtype=np.int32)
    np.cumsum(np.cumsum(_beside_free(occupied), axis=0, dtype=np.int32), axis=1, out=sums[1:, 1:])
    x0, y0, x1, y1 = found.T
    touchable = sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0]
    return found[touchable > 0]


def _beside_free(occupied: Cells) -> Cells:
    """Return the occupied cells that a free one touches, at an edge or a corner."""
    free = np.pad(~occupied, 1)
    free = free[:-2] | free[1:-1] | free[2:]
    free = free[:, :-2] | free[:, 1:-1] | free[:, 2:]
    found: Cells = occupied & free
    return found
