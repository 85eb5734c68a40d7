# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Clearance on a floor, and the certificate that a path keeps it.

The distance to the nearest occupied square is exact at the corners of all cells: it is that to the
nearest corner of an occupied one, which a distance transform of the corners finds. A distance
changes by no more than one moves, so that the corners of a cell bound it from below everywhere in
that cell.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, wraps
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.state import Vector
from sphere_nmpc.process.channel import SharedMemory

_CELL = 1.0 / 24.0
"""Largest side of a cell [Rs] to which a map is refined: in the middle of it the bound is below
the distance by up to 0.2 of the side along a wall, and by 0.7 near a corner."""
MOST_FINE = 4_000_000
"""Cells that a floor is made of, or that a map is refined to, at most."""
_EXACT_RANGE = 4.0
"""Distance up to which it is computed exactly [needed one]."""
_CACHED_CELLS = 16_384
"""Cells whose numbers fit into the cache of a processor core."""
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Floor:
    """Floor of which the sphere has to stay clear of what is occupied.

    Attributes
    ----------
    grid : Grid
        Occupied cells; what is outside of it is occupied, too.
    radius : float
        Radius of the sphere [m].
    clearance : float
        Least distance between the sphere and what is occupied [m].
    """

    grid: Grid
    radius: float
    clearance: float
    kept: dict[str, Any] = field(default_factory=dict, repr=False)
    """Results of `kept_with_floor` by the names of the functions."""
    EMPTY: ClassVar["Floor"]
    """The floor on which nothing stands: without end, and infinitely clear everywhere."""

    def __reduce__(self) -> tuple[Any, ...] | str:
        """Pickle as shared memory, which another process looks at as it is."""
        grid = self.fine
        place = (grid.occupied.shape, grid.resolution, grid.origin, self.radius, self.clearance)
        return _shared, (self._memory, *place)

    @cached_property
    def _memory(self) -> SharedMemory:
        """Distances and what is occupied, in memory that a worker shares."""
        distances, occupied = self.corner_distances, np.ascontiguousarray(self.fine.occupied)
        memory = SharedMemory.of(distances.data, occupied.data)
        # Not twice in this process.
        vars(self)["corner_distances"], _ = _arrays(memory, occupied.shape)
        return memory

    def prepared(self) -> "Floor":
        """Return the floor with all done that takes long: distances, and memory for a worker."""
        self._memory  # noqa: B018 - kept from then on
        return self

    @property
    def needed(self) -> float:
        """Least distance of the sphere's centre from what is occupied [m]."""
        return self.radius + self.clearance

    @property
    def is_empty(self) -> bool:
        """Whether nothing stands on the floor, and it has no end."""
        return False

    @property
    def lasting(self) -> "Floor":
        """The floor without areas to keep out of, which may move: itself where there are none."""
        return self._without_areas or self

    @cached_property
    def _without_areas(self) -> "Floor | None":
        grid = self.grid.lasting
        return None if grid is None else Floor(grid, self.radius, self.clearance)

    @cached_property
    def fine(self) -> Grid:
        """The grid in cells that are small compared with the sphere."""
        grid = finest(self.grid, self.radius)
        for one in (self.grid, grid):
            one.occupied.flags.writeable = False  # strategies are given them
        return grid

    @cached_property
    def corner_distances(self) -> NDArray[np.float32]:
        """Distances from the corners of all fine cells to what is occupied [m], (H + 1, W + 1)."""
        distances = corner_distances(self.fine)
        distances.flags.writeable = False
        return distances

    def distances(self, places: Vector) -> Vector:
        """Return lower bounds of the distances of places, shape (P, 2), to what is occupied [m].

        They are 0 in what is occupied.
        """
        distances, side = self.corner_distances, self.fine.resolution
        height, width = distances.shape
        local = self.fine.local(places)
        cell = np.floor(local)
        outside = ~((cell >= 0.0) & (cell < (width - 1, height - 1))).all(axis=-1)
        cell = np.clip(np.nan_to_num(cell), 0, (width - 2, height - 2)).astype(np.intp)
        share = local - cell
        i, j = cell[..., 1], cell[..., 0]
        best: Vector = np.zeros(share.shape[:-1])
        for di in (0, 1):
            for dj in (0, 1):
                away = np.hypot(share[..., 0] - dj, share[..., 1] - di)
                np.maximum(best, distances[i + di, j + dj] - side * away, out=best)
        best[outside] = 0.0
        return best

    def is_occupied(self, place: Vector) -> bool:
        """Return whether a place, shape (2,), is occupied or outside."""
        height, width = self.grid.occupied.shape
        column, row = self.grid.local(place).tolist()
        inside = 0.0 <= column < width and 0.0 <= row < height
        return not inside or bool(self.grid.occupied[int(row), int(column)])

    def collided(self, paths: NDArray[np.floating], least: float) -> NDArray[np.bool_]:
        """Return from where on paths are nearer to what is occupied than allowed, shape (K, N).

        Parameters
        ----------
        paths : ndarray, shape (K, N, 2)
            Places along N paths from the same place on [m].
        least : float
            Distance that they have to keep [m]; no more than the first place has. For many paths
            of which most are to be discarded it is that of the nearest corners, but for a cell.
        """
        # Half way between two places as well: they are further apart than a sphere from a wall.
        at = self._about(paths)
        np.minimum(at[1:], self._about(0.5 * (paths[1:] + paths[:-1])), out=at[1:])
        wanted = min(least, float(at[0].min())) - self.fine.resolution
        found: NDArray[np.bool_] = np.logical_or.accumulate(at < wanted, axis=0)
        return found

    def _about(self, places: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the distances of the corners nearest to places, shape (..., 2) [m]."""
        distances = self.corner_distances
        height, width = distances.shape
        columns, rows = np.moveaxis(np.rint(self.fine.local(places)), -1, 0)
        inside = (rows >= 0.0) & (rows < height) & (columns >= 0.0) & (columns < width)
        rows, columns = (np.where(inside, at, 0.0).astype(np.intp) for at in (rows, columns))
        found: NDArray[np.float32] = distances[rows, columns] * inside
        return found

    def distance(self, place: Vector) -> float:
        """Return the exact distance of a place, shape (2,), to what is occupied [m].

        No more than four times the needed one: a radius may be found to be that of a sphere three
        times as large.
        """
        return _distance(self, *place.tolist())

    def least_distance(self, place: Vector) -> float:
        """Return the lower bound of the distance of a place, shape (2,) [m]; see `distances`."""
        return _least_distance(self, *place.tolist())


class _EmptyFloor(Floor):
    """Floor on which nothing stands; its answers take no time."""

    def __reduce__(self) -> str:
        return "Floor.EMPTY"

    @property
    def is_empty(self) -> bool:
        return True

    def is_occupied(self, place: Vector) -> bool:
        return False

    def distances(self, places: Vector) -> Vector:
        return np.full(places.shape[:-1], np.inf)

    def collided(self, paths: NDArray[np.floating], least: float) -> NDArray[np.bool_]:
        return np.broadcast_to(np.bool_(False), paths.shape[:-1])

    def distance(self, place: Vector) -> float:
        return math.inf

    def least_distance(self, place: Vector) -> float:
        return math.inf


Floor.EMPTY = _EmptyFloor(Grid(np.zeros((1, 1), dtype=bool), 1.0), 0.0, 0.0)


@lru_cache(maxsize=1)
def _shared(
    memory: SharedMemory, shape: tuple[int, int], resolution: float,
    origin: tuple[float, float, float], radius: float, clearance: float,
) -> Floor:
    """Return the floor that another process has made, of which the newest is kept."""
    distances, occupied = _arrays(memory, shape)
    floor = Floor(Grid(occupied, resolution, origin), radius, clearance)
    # What was computed there is not computed again.
    vars(floor).update(fine=floor.grid, corner_distances=distances, _memory=memory)
    return floor


def _arrays(
    memory: SharedMemory, shape: tuple[int, ...]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return distances and occupied cells, in rows and columns of this `shape`."""
    mapped, corners = memory.mapped(), tuple(size + 1 for size in shape)
    distances = np.frombuffer(mapped, np.float32, math.prod(corners)).reshape(corners)
    occupied = np.frombuffer(mapped, np.bool_, offset=distances.nbytes).reshape(shape)
    return distances, occupied


def kept_with_floor(most: int) -> Callable[[Callable[..., T]], Callable[..., T]]:
    """Let the last `most` results of a function of a floor and numbers be kept with that floor.

    A result that refers to the floor would keep it from being freed before garbage is collected.
    """

    def decorated(function: Callable[..., T]) -> Callable[..., T]:
        @wraps(function)
        def found(floor: Floor, *numbers: float) -> T:
            results: dict[tuple[float, ...], T] = floor.kept.setdefault(function.__name__, {})
            if numbers not in results:
                while len(results) >= most:
                    del results[next(iter(results))]
                results[numbers] = function(floor, *numbers)
            return results[numbers]

        return found

    return decorated


@kept_with_floor(1)  # of a goal the same at nearly every sample
def _distance(floor: Floor, x: float, y: float) -> float:
    return exact_distance(floor.grid, np.array((x, y)), _EXACT_RANGE * floor.needed)


@kept_with_floor(2)  # of a goal and of one on the way there
def _least_distance(floor: Floor, x: float, y: float) -> float:
    return float(floor.distances(np.array([[x, y]]))[0])


def finest_cell(radius: float) -> float:
    """Return the side [m] that is small enough for cells of a floor of a sphere of a radius."""
    return _CELL * radius


def finest(grid: Grid, radius: float) -> Grid:
    """Return a grid in cells that are small compared with a sphere, or as many as are allowed."""
    factor = max(1, math.ceil(grid.resolution / finest_cell(radius) - 1e-9))
    most = math.isqrt(max(1, MOST_FINE // grid.occupied.size))
    return grid.refined(max(1, min(factor, most)))


def corner_distances(grid: Grid) -> NDArray[np.float32]:
    """Return the distances of the corners of all cells to occupied squares [m], (H + 1, W + 1)."""
    height, width = grid.occupied.shape
    padded = np.ones((height + 2, width + 2), dtype=bool)
    padded[1:-1, 1:-1] = grid.occupied
    rows = padded[:-1] | padded[1:]
    touched = rows[:, :-1] | rows[:, 1:]
    from scipy import ndimage  # where nothing stands it is not needed

    # The indices alone take a fifth of the time of the distances, which are in double precision.
    i, j = ndimage.distance_transform_edt(~touched, return_distances=False, return_indices=True)
    found: NDArray[np.float32] = np.empty(touched.shape, dtype=np.float32)
    rows, columns = (np.arange(size, dtype=j.dtype) for size in touched.shape)
    # A few rows at a time: arrays of the whole map are not in the cache, and take several times
    # as long.
    step = max(1, _CACHED_CELLS // columns.size)
    for first in range(0, rows.size, step):
        some = slice(first, first + step)
        away = (i[some] - rows[some, None]).astype(np.float32)
        np.hypot(away, (j[some] - columns).astype(np.float32), out=found[some])
    found *= np.float32(grid.resolution)
    return found


def exact_distance(grid: Grid, place: Vector, reach: float) -> float:
    """Return the distance of a place, shape (2,), to occupied squares [m], up to `reach`."""
    height, width = grid.occupied.shape
    x, y = grid.local(place)
    span = reach / grid.resolution
    if not (np.isfinite(x) and np.isfinite(y)):
        return 0.0
    edge = min(x, y, width - x, height - y)
    least = max(0.0, min(span, float(edge)))
    low_x, low_y = max(0, math.floor(x - span)), max(0, math.floor(y - span))
    near = grid.occupied[low_y : math.floor(y + span) + 1, low_x : math.floor(x + span) + 1]
    if least == 0.0 or not near.any():
        return least * grid.resolution
    rows, columns = np.nonzero(near)
    dx = np.maximum(0.0, np.maximum(columns + low_x - x, x - columns - low_x - 1))
    dy = np.maximum(0.0, np.maximum(rows + low_y - y, y - rows - low_y - 1))
    return min(least, float(np.min(np.hypot(dx, dy)))) * grid.resolution
