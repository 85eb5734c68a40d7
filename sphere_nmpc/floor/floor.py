# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Clearance on a floor, and the certificate that a path keeps it.

The distance to the nearest occupied square is exact at the corners of all cells: it is that to the
nearest corner of an occupied one, which a distance transform of the corners finds. A distance
changes by no more than one moves, so that the corners of a cell bound it from below everywhere in
that cell.
"""

import math
import shutil
import tempfile
import weakref
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.state import Vector

_CELL = 1.0 / 24.0
"""Largest side of a cell [Rs] to which a map is refined: in the middle of it the bound is below
the distance by up to 0.2 of the side along a wall, and by 0.7 near a corner ..."""
_MOST_REFINED = 4_000_000
"""... as long as there are no more cells."""
_CACHED = 16_384
"""Cells whose numbers fit into the cache of a processor core."""
_OCCUPIED, _DISTANCES = "occupied.npy", "distances.npy"
FALL = 1e-3
"""Decrease of the clearance [m] that counts as none where it is too small already."""


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
    cache: dict[str, object] = field(default_factory=dict, repr=False)
    """Ways to goals."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as the path of files, which another process loads once."""
        grid = self.fine
        place = (grid.resolution, grid.origin, self.radius, self.clearance)
        return _loaded, (str(self._folder), *place)

    @cached_property
    def _folder(self) -> Path:
        """Folder of the files with what is occupied and the distances, as long as this exists."""
        folder = Path(tempfile.mkdtemp(prefix="sphere_nmpc_floor_"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        np.save(folder / _OCCUPIED, self.fine.occupied, allow_pickle=False)
        np.save(folder / _DISTANCES, self.corner_distances, allow_pickle=False)
        return folder

    def prepared(self) -> "Floor":
        """Return the floor with all done that takes long: distances, and files for a worker."""
        self._folder  # noqa: B018 - kept from then on
        return self

    @property
    def needed(self) -> float:
        """Least distance of the sphere's centre from what is occupied [m]."""
        return self.radius + self.clearance

    @cached_property
    def fine(self) -> Grid:
        """The grid in cells that are small compared with the sphere."""
        return finest(self.grid, self.radius)

    @cached_property
    def corner_distances(self) -> NDArray[np.float32]:
        """Distances from the corners of all fine cells to what is occupied [m], (H + 1, W + 1)."""
        return corner_distances(self.fine)

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

    def about(self, places: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the distances of places, shape (P, 2), to what is occupied [m], but for a cell.

        They are those of the nearest corners, for many places of which most are to be discarded.
        """
        distances = self.corner_distances
        height, width = distances.shape
        columns, rows = np.rint(self.fine.local(places)).T
        inside = (rows >= 0.0) & (rows < height) & (columns >= 0.0) & (columns < width)
        rows, columns = (np.where(inside, at, 0.0).astype(np.intp) for at in (rows, columns))
        found: NDArray[np.float32] = distances[rows, columns] * inside
        return found

    def distance(self, place: Vector) -> float:
        """Return the exact distance of a place, shape (2,), to what is occupied [m].

        No more than twice the needed one.
        """
        return exact_distance(self.grid, place, 2.0 * self.needed)


@lru_cache(maxsize=2)
def _loaded(
    folder: str, resolution: float, origin: tuple[float, float, float], radius: float,
    clearance: float,
) -> Floor:
    """Return the floor that another process has written to files."""
    occupied = np.load(Path(folder) / _OCCUPIED, mmap_mode="r", allow_pickle=False)
    floor = Floor(Grid(occupied, resolution, origin), radius, clearance)
    # What was computed there is not computed again.
    known: dict[str, Any] = vars(floor)
    known["fine"] = floor.grid
    known["corner_distances"] = np.load(
        Path(folder) / _DISTANCES, mmap_mode="r", allow_pickle=False
    )
    return floor


def finest_cell(radius: float) -> float:
    """Return the side [m] that is small enough for cells of a floor of a sphere of a radius."""
    return _CELL * radius


def finest(grid: Grid, radius: float) -> Grid:
    """Return a grid in cells that are small compared with a sphere, or as many as are allowed."""
    factor = max(1, math.ceil(grid.resolution / finest_cell(radius) - 1e-9))
    most = math.isqrt(max(1, _MOST_REFINED // grid.occupied.size))
    return grid.refined(max(1, min(factor, most)))


def corner_distances(grid: Grid) -> NDArray[np.float32]:
    """Return the distances of the corners of all cells to occupied squares [m], (H + 1, W + 1)."""
    height, width = grid.occupied.shape
    padded = np.ones((height + 2, width + 2), dtype=bool)
    padded[1:-1, 1:-1] = grid.occupied
    rows = padded[:-1] | padded[1:]
    touched = rows[:, :-1] | rows[:, 1:]
    # The indices alone take a fifth of the time of the distances, which are in double precision.
    i, j = ndimage.distance_transform_edt(~touched, return_distances=False, return_indices=True)
    found: NDArray[np.float32] = np.empty(touched.shape, dtype=np.float32)
    rows, columns = (np.arange(size, dtype=j.dtype) for size in touched.shape)
    # A few rows at a time: arrays of the whole map are not in the cache, and take several times
    # as long.
    step = max(1, _CACHED // columns.size)
    for first in range(0, rows.size, step):
        some = slice(first, first + step)
        away = (i[some] - rows[some, None]).astype(np.float32)
        np.hypot(away, (j[some] - columns).astype(np.float32), out=found[some])
    found *= np.float32(grid.resolution)
    return found


def certified_distance(distances: Vector, lengths: Vector, needed: float) -> float:
    """Return a distance that a whole path keeps [m], nan if it is not certified to keep enough.

    Parameters
    ----------
    distances : ndarray, shape (K,)
        Lower bounds of the distances at the samples of the path [m].
    lengths : ndarray, shape (K - 1,)
        Upper bounds of the lengths of the path between them [m].
    needed : float
        Distance that is to be kept [m]; where the path begins with less, its distance must not
        fall until it has that.
    """
    # From one sample the distance falls and to the next one it rises by no more than the way.
    between = 0.5 * (distances[:-1] + distances[1:] - lengths)
    if distances[0] >= needed:
        least = float(np.min(between, initial=float(distances[0])))
        return least if least >= needed else math.nan
    reached = np.maximum.accumulate(distances)
    # Short of it at the start, a path is only known at its samples.
    known = np.where(reached[:-1] < needed, distances[1:], between)
    if np.any(known < np.minimum(needed, reached[1:]) - FALL):
        return math.nan
    return float(np.min(distances))


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
