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

from sphere_nmpc.errors import Description, InvalidParameterError
from sphere_nmpc.model.state import FARTHEST, Vector
from sphere_nmpc.quantities import counted

MOST_CELLS = 10**8
"""Cells of the largest map that is accepted."""
MOST_CORNERS = 5000
"""Corners of a polygon, with which the check of pairs of its edges takes up to five seconds."""
_MIN_CELL = 1e-4
"""Smallest side of a cell [m]: a twelfth of that which a sphere of 3 cm needs."""
_MAX_TILT = 1e-3
"""Largest roll and pitch of a map's origin [rad]."""
_BLOCK_SIZE = 1_000_000
"""Cells, or pairs of edges, that are computed together, which take some 100 MB."""
_HALF_WIDTH = math.sqrt(0.5)
"""Distance of an edge from the centre of a cell up to which it counts as touched [cells]."""

Cells = NDArray[np.bool_]
Runs = NDArray[np.int64]
"""Cells as intervals of their indices in row-major order, disjoint and in order, shape (R, 2)."""


class InvalidMapError(InvalidParameterError):
    """Map, polygon or map file that cannot be used; what was in force before stays.

    What is `given` is described.
    """

    def __init__(self, name: str, given: str, expected: str) -> None:
        super().__init__(name, Description(given), expected)


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
    lasting : Grid or None
        The same cells without areas to keep out of, which may move; None where there are none.
    """

    occupied: Cells
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lasting: "Grid | None" = None

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

    def within(self, polygon: Vector) -> "Grid":
        """Return the grid with the cells occupied that are not wholly inside a polygon [m]."""
        edge, inside = _runs_of(self, polygon)
        outside = Grid(np.ones(self.occupied.shape, dtype=bool), self.resolution, self.origin)
        _fill(outside.occupied, inside, False)
        _fill(outside.occupied, edge, True)
        outside.occupied[self.occupied] = True
        return outside

    def with_runs(self, runs: Sequence[Runs]) -> "Grid":
        """Return the grid with more cells occupied."""
        occupied = self.occupied.copy()
        for each in runs:
            _fill(occupied, each, True)
        return Grid(occupied, self.resolution, self.origin)


def touched_runs(grid: Grid, polygon: Vector) -> Runs:
    """Return the cells that a polygon, shape (K, 2) [m], touches."""
    return _joined(np.concatenate(_runs_of(grid, polygon)))


def _runs_of(grid: Grid, polygon: Vector) -> tuple[Runs, Runs]:
    """Return the cells that the edges of a polygon touch, and those with centres inside."""
    height, width = grid.occupied.shape
    begin = grid.local(polygon)
    end = np.roll(begin, -1, axis=0)
    low, high = np.minimum(begin, end)[:, 1], np.maximum(begin, end)[:, 1]
    first = np.clip(np.ceil(low - _HALF_WIDTH - 0.5), 0, height).astype(np.int64)
    last = np.clip(np.floor(high + _HALF_WIDTH + 0.5), 0, height).astype(np.int64)
    edge: Runs = np.empty((0, 2), np.int64)
    inside = edge
    # All edges in some rows at a time, so that a row has all its crossings.
    step = max(1, _BLOCK_SIZE // len(polygon))
    for row in range(int(first.min()), int(last.max()), step):
        found = _runs_of_rows(begin, end, first.clip(row), last.clip(None, row + step), width)
        edge, inside = np.concatenate((edge, found[0])), np.concatenate((inside, found[1]))
    return _joined(edge), _joined(inside)


def _runs_of_rows(
    begin: Vector, end: Vector, first: NDArray[np.int64], last: NDArray[np.int64], width: int
) -> tuple[Runs, Runs]:
    """Return what `_runs_of` does of the rows from `first` to `last` of each edge, shape (K,)."""
    counts = np.maximum(0, last - first)
    at = np.repeat(np.arange(len(begin)), counts)
    rows = np.arange(at.size) - np.repeat(np.cumsum(counts) - counts, counts) + first[at]
    (x0, y0), (x1, y1), y = begin[at].T, end[at].T, rows + 0.5
    dx, dy, away = x1 - x0, y1 - y0, y - y0
    # Places within reach of an edge are a convex set: in a row an interval, each end of which is
    # at the distance `sqrt(reach^2 - v^2)` from a place t on the edge that is v below or above.
    with np.errstate(divide="ignore", invalid="ignore"):
        span = np.sort(np.stack(((away - _HALF_WIDTH) / dy, (away + _HALF_WIDTH) / dy)), axis=0)
        tangent = _HALF_WIDTH * dx / np.hypot(dx, dy) * np.sign(dy)
        tangents = np.stack(((away - tangent) / dy, (away + tangent) / dy))
    level = dy == 0.0
    span[:, level] = [[0.0], [1.0]]
    tangents[:, level] = np.where(dx[level] > 0.0, [[0.0], [1.0]], [[1.0], [0.0]])
    t = np.clip(tangents, *np.clip(span, 0.0, 1.0))
    aside = np.sqrt(np.maximum(0.0, _HALF_WIDTH**2 - (away - t * dy) ** 2))
    left, right = x0 + t * dx + aside * [[-1.0], [1.0]]
    # The rows whose centre line an edge crosses: between two crossings cells are inside.
    # As corners are compared, not differences, edges that meet agree on where they do.
    crosses = (np.minimum(y0, y1) <= y) & (y < np.maximum(y0, y1))
    x = x0[crosses] + away[crosses] / dy[crosses] * dx[crosses]
    order = np.lexsort((x, rows[crosses]))
    enters, leaves = np.ceil(x[order].reshape(-1, 2).T - 0.5)
    return (
        _joined(_columns(rows, np.ceil(left - 0.5), np.floor(right + 0.5), width)),
        _joined(_columns(rows[crosses][order][::2], enters, leaves, width)),
    )


def _columns(
    rows: NDArray[np.int64], left: Vector, right: Vector, width: int
) -> Runs:
    """Return the cells of rows from a column to before another one."""
    ends = np.clip(np.stack((left, right), axis=1), 0, width).astype(np.int64)
    found: Runs = (ends + rows[:, None] * width)[ends[:, 0] < ends[:, 1]]
    return found


def _joined(runs: Runs) -> Runs:
    """Return runs in order, with those that overlap or touch as one."""
    if not len(runs):
        return runs
    runs = runs[np.argsort(runs[:, 0], kind="stable")]
    ends = np.maximum.accumulate(runs[:, 1])
    is_first = np.concatenate(([True], runs[1:, 0] > ends[:-1]))
    return np.stack((runs[is_first, 0], ends[np.append(is_first[1:], True)]), axis=1)


def _fill(cells: Cells, runs: Runs, value: bool) -> None:
    """Set cells in runs."""
    if not len(runs):
        return
    flat, begin = cells.reshape(-1), int(runs[0, 0])
    steps = np.zeros(int(runs[-1, 1]) - begin + 1, dtype=np.int8)
    steps[runs[:, 0] - begin] = 1
    steps[runs[:, 1] - begin] = -1
    within = np.cumsum(steps[:-1], dtype=np.int8, out=steps[:-1]).view(bool)
    flat[begin : begin + within.size][within] = value


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
        For what `check_geometry` refuses, a size that is not width times height, and values
        outside -1 to 100.
    """
    place = check_geometry("map", width, height, resolution, origin)
    if values.size != width * height:
        given = counted(values.size, "value")
        raise InvalidMapError("map", given, f"width x height, {width * height}")
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


def check_geometry(
    name: str, width: int, height: int, resolution: float, origin: Sequence[float]
) -> tuple[float, float, float]:
    """Return place [m] and heading [rad] of the corner of the first cell of a grid.

    `origin` has its position and quaternion xyzw. `InvalidMapError` is raised for more cells than
    `MOST_CELLS`, cells that are too small, corners out of reach, and an origin that is not finite
    or is tilted; `name` is what it is of. What is accepted can be used by all nodes.
    """
    if width < 1 or height < 1 or width * height > MOST_CELLS:
        raise InvalidMapError(name, f"{width} x {height} cells", f"1 to {MOST_CELLS} cells")
    # Messages have it in single precision.
    if not (math.isfinite(resolution) and resolution >= float(np.float32(_MIN_CELL))):
        raise InvalidMapError(
            name, f"a resolution of {resolution:g} m", f"a positive number, {_MIN_CELL:g} or more"
        )
    x, y, _, *quaternion = (float(value) for value in origin)
    if not all(map(math.isfinite, (x, y, *quaternion))):
        raise InvalidMapError(name, f"the origin {list(origin)}", "finite numbers")
    norm = math.hypot(*quaternion)
    yaw = 0.0
    if norm >= 1e-6:  # otherwise as of a message that was not filled in
        qx, qy, qz, qw = (value / norm for value in quaternion)
        if 2.0 * math.hypot(qx, qy) > _MAX_TILT:
            raise InvalidMapError(name, "an origin with roll or pitch", "a heading alone")
        yaw = 2.0 * math.atan2(qz, qw)
    c, s = math.cos(yaw) * resolution, math.sin(yaw) * resolution
    corners = [
        (x + c * i - s * j, y + s * i + c * j) for i in (0, width) for j in (0, height)
    ]
    farthest = max(abs(value) for corner in corners for value in corner)
    if not farthest <= FARTHEST:
        raise InvalidMapError(
            name, f"a corner at {farthest:.7g} m", f"all within {FARTHEST:g} m along each axis"
        )
    return x, y, yaw


def check_polygon(name: str, corners: Sequence[Sequence[float]]) -> Vector:
    """Return a polygon as an array, shape (K, 2) [m].

    `InvalidMapError` is raised for less than three corners or more than `MOST_CORNERS`, some that
    are not finite or out of reach, edges that cross or an area of zero; `name` is how it is called
    there.
    """
    count = len(corners)
    if count > MOST_CORNERS:
        raise InvalidMapError(name, counted(count, "corner"), f"three to {MOST_CORNERS}")
    polygon = np.array([[float(x), float(y)] for x, y, *_ in corners]).reshape(-1, 2)
    # In this way also where one is not a number.
    if count < 3 or not (np.abs(polygon) <= FARTHEST).all():
        raise InvalidMapError(
            name, counted(count, "corner"), f"three or more, finite, within {FARTHEST:g} m"
        )
    after = np.roll(polygon, -1, axis=0)
    crossing = _first_crossing(polygon, after)
    if crossing is not None:
        raise InvalidMapError(
            name, "edges {} and {} that cross".format(*crossing), "a simple polygon"
        )
    area = np.sum(polygon[:, 0] * after[:, 1] - polygon[:, 1] * after[:, 0])
    if abs(area) < 1e-9:
        raise InvalidMapError(name, "an area of 0", "a polygon with an area")
    return polygon


def _first_crossing(begin: Vector, end: Vector) -> tuple[int, int] | None:
    """Return two edges, each end of shape (K, 2) [m], that cross and are not neighbours."""
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    # Along that axis along which fewer edges overlap.
    pairs = min((_overlaps(*ends) for ends in zip(low.T, high.T, strict=True)), key=_number)
    order, counts = pairs
    below = np.cumsum(counts)
    first = 0
    while first < len(order):
        last = max(first + 1, int(np.searchsorted(below, below[first] + _BLOCK_SIZE)))
        some = counts[first:last]
        at = np.repeat(np.arange(first, last), some)
        other = np.arange(at.size) - np.repeat(np.cumsum(some) - some, some) + at + 1
        i, j = np.sort(np.stack((order[at], order[other])), axis=0)
        apart = (j > i + 1) & (j - i < len(order) - 1)  # the last one ends at the first
        i, j = i[apart], j[apart]
        crossed = np.flatnonzero(_crossed(begin[i], end[i], begin[j], end[j]))
        if crossed.size:
            return min(zip(i[crossed].tolist(), j[crossed].tolist(), strict=True))
        first = last
    return None


def _overlaps(low: Vector, high: Vector) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return intervals in the order of their beginnings, and how many begin within each, (K,)."""
    order = np.argsort(low)
    within = np.searchsorted(low[order], high[order], side="right") - np.arange(len(low)) - 1
    return order, within


def _number(pairs: tuple[NDArray[np.intp], NDArray[np.intp]]) -> int:
    return int(pairs[1].sum())


def _crossed(a: Vector, b: Vector, c: Vector, d: Vector) -> NDArray[np.bool_]:
    """Return which segments ab and cd, each end of shape (K, 2), have a point in common."""
    def side(p: Vector, q: Vector, r: Vector) -> Vector:
        found: Vector = (q - p)[..., 0] * (r - p)[..., 1] - (q - p)[..., 1] * (r - p)[..., 0]
        return found

    first, second = side(a, b, c) * side(a, b, d), side(c, d, a) * side(c, d, b)
    most, least = np.maximum(first, second), np.minimum(first, second)
    found: NDArray[np.bool_] = (most <= 0.0) & (least < 0.0)
    return found
