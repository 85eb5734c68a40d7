# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Occupancy grid of a floor, and polygons that are entered into it.

Cells are whole squares: one that a polygon touches is occupied as a whole, so that a distance to
occupied cells is never larger than that to what they stand for.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.state import Vector

MOST_CELLS = 10**8
"""Cells of the largest map that is accepted."""
_FARTHEST = 1e6
"""Largest coordinate of a polygon [m]."""
_MOST_TILT = 1e-3
"""Largest roll and pitch of a map's origin [rad]."""

Cells = NDArray[np.bool_]


class InvalidMapError(InvalidParameterError):
    """Map, polygon or map file that cannot be used; what was in force before stays."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Square cells of a floor, of which some are occupied.

    Attributes
    ----------
    occupied : ndarray of bool, shape (H, W)
        Row 0 is at the origin, rows along the grid's y axis.
    resolution : float
        Side of a cell [m].
    origin : tuple of float
        Place [m] and heading [rad] of the corner of the first cell in the world frame.
    """

    occupied: Cells
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def local(self, places: NDArray[np.floating]) -> Vector:
        """Return places in the world, shape (..., 2) [m], in the grid's axes [cells]."""
        x, y, yaw = self.origin
        moved = places - np.array((x, y))
        if yaw:
            c, s = math.cos(yaw), math.sin(yaw)
            moved = moved @ np.array([[c, -s], [s, c]])
        found: Vector = moved / self.resolution
        return found

    def world(self, local: Vector) -> Vector:
        """Return places in the grid's axes, shape (..., 2) [cells], in the world [m]."""
        x, y, yaw = self.origin
        found: Vector = self.resolution * local
        if yaw:
            c, s = math.cos(yaw), math.sin(yaw)
            found = found @ np.array([[c, s], [-s, c]])
        return found + np.array((x, y))

    def contains(self, place: Vector) -> bool:
        """Return whether a place in the world, shape (2,) [m], is on the grid."""
        height, width = self.occupied.shape
        x, y = self.local(place)
        return bool(0.0 <= x <= width and 0.0 <= y <= height)

    def refined(self, factor: int) -> "Grid":
        """Return the same floor in cells of a fraction of the size."""
        if factor <= 1:
            return self
        finer = np.repeat(np.repeat(self.occupied, factor, axis=0), factor, axis=1)
        return Grid(finer, self.resolution / factor, self.origin)

    def with_obstacle(self, polygon: Vector) -> "Grid":
        """Return the grid with the cells occupied that a polygon, shape (K, 2) [m], touches."""
        edge, inside = self._cells_of(polygon)
        return Grid(self.occupied | edge | inside, self.resolution, self.origin)

    def within(self, polygon: Vector) -> "Grid":
        """Return the grid with the cells occupied that are not wholly inside a polygon [m]."""
        edge, inside = self._cells_of(polygon)
        return Grid(self.occupied | edge | ~inside, self.resolution, self.origin)

    def _cells_of(self, polygon: Vector) -> tuple[Cells, Cells]:
        """Return the cells that the edges of a polygon touch, and those with centres inside."""
        height, width = self.occupied.shape
        corners = self.local(polygon)
        edge, inside = np.zeros((2, height, width), dtype=bool)
        ys = np.arange(height) + 0.5
        for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            low = np.floor(np.minimum((x0, y0), (x1, y1))).astype(int) - 1
            high = np.ceil(np.maximum((x0, y0), (x1, y1))).astype(int) + 1
            i0, i1 = np.clip((low[1], high[1]), 0, height)
            j0, j1 = np.clip((low[0], high[0]), 0, width)
            if i1 > i0 and j1 > j0:
                along = np.array((x1 - x0, y1 - y0))
                square = max(float(along @ along), 1e-12)
                dx = np.arange(j0, j1)[None, :] + 0.5 - x0
                dy = np.arange(i0, i1)[:, None] + 0.5 - y0
                share = np.clip((dx * along[0] + dy * along[1]) / square, 0.0, 1.0)
                apart = np.hypot(dx - share * along[0], dy - share * along[1])
                edge[i0:i1, j0:j1] |= apart <= math.sqrt(0.5)
            # The rows whose centre line the edge crosses: all cells beyond it change sides.
            for i in np.flatnonzero((ys >= min(y0, y1)) & (ys < max(y0, y1))):
                x = x0 + (ys[i] - y0) / (y1 - y0) * (x1 - x0)
                inside[i, max(0, math.ceil(x - 0.5)):] ^= True
        return edge, inside


def grid_of_values(
    values: NDArray[np.int8], width: int, height: int, resolution: float, origin: Sequence[float],
    occupied_threshold: float, unknown_is_free: bool,
) -> Grid:
    """Return the grid of a map message, whose values are 0 to 100 per cent and -1 for unknown.

    Parameters
    ----------
    values : ndarray of int8
        Row by row.
    width, height : int
        Numbers of cells.
    resolution : float
        Side of a cell [m].
    origin : sequence of float, seven of them
        Position and quaternion xyzw of the first cell's corner.
    occupied_threshold : float
        Share [-] from which on a cell is occupied.
    unknown_is_free : bool
        Whether cells of unknown occupancy are free.

    Raises
    ------
    InvalidMapError
        For a size that is not width times height, more than `MOST_CELLS`, a resolution that is not
        positive and finite, values outside -1 to 100, an origin that is not finite or is tilted.
    """
    if width < 1 or height < 1 or width * height > MOST_CELLS:
        raise InvalidMapError("map", f"{width} x {height} cells", f"1 to {MOST_CELLS} cells")
    if values.size != width * height:
        raise InvalidMapError("map", f"{values.size} values", f"width x height, {width * height}")
    place = check_geometry(resolution, origin)
    low, high = int(values.min()), int(values.max())
    if low < -1 or high > 100:
        wrong = low if low < -1 else high
        raise InvalidMapError("map", f"a value of {wrong}", "-1 (unknown) or 0 to 100")
    # As unsigned numbers unknown cells are the largest.
    limit = math.ceil(100.0 * occupied_threshold)
    occupied = values.view(np.uint8) >= limit
    if unknown_is_free:
        occupied &= values >= 0
    return Grid(occupied.reshape(height, width), resolution, place)


def check_geometry(resolution: float, origin: Sequence[float]) -> tuple[float, float, float]:
    """Return place and heading of a map's origin, position and quaternion xyzw; see above."""
    if not (math.isfinite(resolution) and resolution > 0.0):
        raise InvalidMapError("map", f"a resolution of {resolution:g} m", "a positive number")
    x, y, _, *quaternion = (float(value) for value in origin)
    if not all(map(math.isfinite, (x, y, *quaternion))):
        raise InvalidMapError("map", f"the origin {list(origin)}", "finite numbers")
    qx, qy, qz, qw = quaternion
    norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    if norm < 1e-6:  # as of a message that was not filled in
        return x, y, 0.0
    if 2.0 * math.hypot(qx, qy) > _MOST_TILT * norm:
        raise InvalidMapError("map", "an origin with roll or pitch", "a heading alone")
    return x, y, 2.0 * math.atan2(qz, qw)


def check_polygon(name: str, corners: Sequence[Sequence[float]]) -> Vector:
    """Return a polygon as an array, shape (K, 2) [m].

    `InvalidMapError` is raised for less than three corners, some that are not finite or out of
    reach, edges that cross or an area of zero; `name` is how it is called there.
    """
    polygon = np.array([[float(x), float(y)] for x, y, *_ in corners]).reshape(-1, 2)
    # In this way also where one is not a number.
    if len(polygon) < 3 or not (np.abs(polygon) <= _FARTHEST).all():
        raise InvalidMapError(
            name, f"{len(polygon)} corners", f"three or more, finite, within {_FARTHEST:g} m"
        )
    after = np.roll(polygon, -1, axis=0)
    count = len(polygon)
    for i in range(count - 2):
        others = slice(i + 2, count - 1 if i == 0 else count)  # the last one ends at the first
        crossed = _crossed(polygon[i], after[i], polygon[others], after[others])
        if crossed.any():
            j = i + 2 + int(np.argmax(crossed))
            raise InvalidMapError(name, f"edges {i} and {j} that cross", "a simple polygon")
    area = np.sum(polygon[:, 0] * after[:, 1] - polygon[:, 1] * after[:, 0])
    if abs(area) < 1e-9:
        raise InvalidMapError(name, "an area of 0", "a polygon with an area")
    return polygon


def _crossed(a: Vector, b: Vector, c: Vector, d: Vector) -> NDArray[np.bool_]:
    """Return which segments cd, each end of shape (K, 2), have a point in common with ab."""
    def side(p: Vector, q: Vector, r: Vector) -> Vector:
        found: Vector = (q - p)[..., 0] * (r - p)[..., 1] - (q - p)[..., 1] * (r - p)[..., 0]
        return found

    first, second = side(a, b, c) * side(a, b, d), side(c, d, a) * side(c, d, b)
    most, least = np.maximum(first, second), np.minimum(first, second)
    found: NDArray[np.bool_] = (most <= 0.0) & (least < 0.0)
    return found
