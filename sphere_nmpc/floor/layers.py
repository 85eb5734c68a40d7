# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the floor of a sphere is put together from: a map, an edge and areas to keep out of."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from sphere_nmpc.floor.floor import finest, finest_cell
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.state import Vector

_AROUND = 25.0
"""Free floor around areas to keep out of, where neither a map nor an edge says how far it goes
[m]."""
_MOST_CELLS = 4_000_000
"""Cells of a floor without a map."""


@dataclass(frozen=True, eq=False)
class Layers:
    """Map, edge and areas to keep out of; each may be missing.

    Attributes
    ----------
    map : Grid or None
        Occupied cells of the map.
    edge : ndarray, shape (K, 2), or None
        Corners of the polygon in which the sphere has to stay [m].
    keepouts : mapping of int to ndarray, shape (K, 2)
        Corners of the polygons that are to be kept out of [m], by their ids.
    """

    map: Grid | None = None
    edge: Vector | None = None
    keepouts: Mapping[int, Vector] = field(default_factory=dict)

    def with_keepout(self, number: int, polygon: Vector | None) -> "Layers":
        """Return the layers with an area to keep out of, or without it where `polygon` is None."""
        kept = {key: value for key, value in self.keepouts.items() if key != number}
        if polygon is not None:
            kept[number] = polygon
        return replace(self, keepouts=kept)

    def grid(self, radius: float) -> Grid | None:
        """Return the cells that the sphere of that radius [m] must not touch; None without any."""
        polygons = list(self.keepouts.values())
        if self.map is not None:
            grid = finest(self.map, radius) if polygons or self.edge is not None else self.map
        elif self.edge is not None:
            grid = _free(self.edge, 0.0, radius)
        elif polygons:
            grid = _free(np.vstack((*polygons, np.zeros((1, 2)))), _AROUND, radius)
        else:
            return None
        if self.edge is not None:
            grid = grid.within(self.edge)
        for polygon in polygons:
            grid = grid.with_obstacle(polygon)
        return grid


def _free(places: Vector, around: float, radius: float) -> Grid:
    """Return a grid of free cells that reaches beyond places by a distance [m]."""
    low, high = places.min(axis=0) - around, places.max(axis=0) + around
    size = high - low
    cell = max(finest_cell(radius), math.sqrt(float(size[0] * size[1]) / _MOST_CELLS))
    columns, rows = np.maximum(1, np.ceil(size / cell - 1e-9)).astype(int)
    return Grid(np.zeros((rows, columns), dtype=bool), cell, (float(low[0]), float(low[1]), 0.0))
