# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the floor of a sphere is put together from: a map, an edge and areas to keep out of."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from sphere_nmpc.floor.floor import MOST_FINE, finest, finest_cell
from sphere_nmpc.floor.occupancy import Grid, InvalidMapError, Runs, check_geometry, touched_runs
from sphere_nmpc.model.state import Vector

MOST_AREAS = 1000
"""Areas to keep out of; on a new map it takes about a second to enter all of them."""
_FREE_MARGIN = 84.0
"""Free floor around areas to keep out of, where neither a map nor an edge says how far it goes
[Rs]: 25 m for the robot of the paper."""
_BOUNDS_STEP = 17.0
"""What the bounds of the free floor around areas are rounded to [Rs], so that an area that moves
mostly leaves them as they are."""
_MAX_CELL = 0.25
"""Largest side of a cell of a floor without a map [Rs]: in larger ones the bounds of the distances
are too far below them for a sphere to pass between obstacles."""


@dataclass
class _Kept:
    """Cells of layers that have been computed, for those layers that are made from them."""

    of: tuple[object, ...] = ()
    """What `base` is made of."""
    base: Grid | None = None
    """Cells of map and edge."""
    areas: dict[int, tuple[Vector, Runs]] = field(default_factory=dict)
    """Polygon and cells of each area that has been entered into it."""


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
    kept: _Kept = field(default_factory=_Kept, repr=False)

    def with_keepout(self, number: int, polygon: Vector | None) -> "Layers":
        """Return the layers with an area to keep out of, or without it where `polygon` is None.

        `InvalidMapError` is raised where there are too many.
        """
        areas = {key: value for key, value in self.keepouts.items() if key != number}
        if polygon is not None:
            if len(areas) >= MOST_AREAS:
                raise InvalidMapError(
                    f"keepout {number}", f"{len(areas) + 1} areas", f"at most {MOST_AREAS}; one "
                    "without points removes an area"
                )
            areas[number] = polygon
        return replace(self, keepouts=areas)

    def grid(self, radius: float) -> Grid | None:
        """Return the cells that the sphere of that radius [m] must not touch; None without any.

        Of a layer that is as before the cells are not computed again. `InvalidMapError` is raised
        where the floor is too large.
        """
        base = self.base(radius)
        if base is None or not self.keepouts:
            return base
        known = self.kept.areas
        self.kept.areas = areas = {
            number: known[number] if number in known and known[number][0] is polygon
            else (polygon, touched_runs(base, polygon))
            for number, polygon in self.keepouts.items()
        }
        return replace(base.with_runs([runs for _, runs in areas.values()]), lasting=base)

    def base(self, radius: float) -> Grid | None:
        """Return the cells without those that areas touch; otherwise as `grid`."""
        polygons, bounds = list(self.keepouts.values()), None
        if self.map is None and self.edge is None and polygons:
            bounds = _around(np.vstack((*polygons, np.zeros((1, 2)))), radius)
        is_alone = not polygons and self.edge is None
        parts = (self.map, self.edge, bounds, is_alone, radius)
        if not all(map(_is_same, parts, self.kept.of)) or not self.kept.of:
            base = self._base(bounds, is_alone, radius)
            self.kept.of, self.kept.base, self.kept.areas = parts, base, {}
        return self.kept.base

    def _base(
        self, bounds: tuple[float, ...] | None, is_alone: bool, radius: float
    ) -> Grid | None:
        if self.map is not None:
            grid = self.map if is_alone else finest(self.map, radius)
        elif self.edge is not None:
            grid = _free("floor", (*self.edge.min(axis=0), *self.edge.max(axis=0)), radius)
        elif bounds is not None:
            farthest = max(self.keepouts, key=lambda number: np.abs(self.keepouts[number]).max())
            grid = _free(f"keepout {farthest}", bounds, radius)
        else:
            return None
        return grid if self.edge is None else grid.within(self.edge)


def _is_same(one: object, other: object) -> bool:
    return one is other or (isinstance(one, float | tuple) and one == other)


def _around(places: Vector, radius: float) -> tuple[float, ...]:
    """Return the bounds of a free floor around places: least x and y, and largest [m]."""
    around, rounded = _FREE_MARGIN * radius, _BOUNDS_STEP * radius
    low = np.floor((places.min(axis=0) - around) / rounded) * rounded
    high = np.ceil((places.max(axis=0) + around) / rounded) * rounded
    return (*low.tolist(), *high.tolist())


def _free(name: str, bounds: tuple[float, ...], radius: float) -> Grid:
    """Return a grid of free cells within bounds: least x and y, and largest [m]."""
    x, y, *most = (float(value) for value in bounds)
    size, coarsest = (most[0] - x, most[1] - y), _MAX_CELL * radius
    # With a cell more on each side, as also a narrow floor has whole ones.
    whole = (size[0] + coarsest) * (size[1] + coarsest)
    cell = max(finest_cell(radius), math.sqrt(whole / MOST_FINE))
    if cell > coarsest:
        raise InvalidMapError(
            name, f"a floor of {size[0]:.4g} m x {size[1]:.4g} m",
            f"at most {MOST_FINE * coarsest**2:.4g} m^2 for a sphere of {radius:g} m"
        )
    columns, rows = (max(1, math.ceil(side / cell - 1e-9)) for side in size)
    check_geometry(name, columns, rows, cell, (x, y, 0.0, 0.0, 0.0, 0.0, 1.0))
    return Grid(np.zeros((rows, columns), dtype=bool), cell, (x, y, 0.0))
