# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time lost on the way in one direction, by orientation at one end: a table kept between studies.

It is the complement of the largest displacement S of `sphere_sim.study.displacement`: within t a
sphere that starts in an orientation gets at most FASTEST (t - lost time) far.
"""

import contextlib
import functools
import hashlib
import logging
import math
import os
import tempfile
import zlib
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress

from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector
from sphere_nmpc.own_folder import cache_folder, own_folder
from sphere_sim.study.displacement import FASTEST, DisplacementSteps
from sphere_sim.study.orientation_grid import OrientationGrid, angles_of
from sphere_sim.study.progress import shown

SIZE = 48
"""Nodes in a quarter turn: 40 s of one core; the time grows with the fourth power."""
_VERSION = 1
"""To be raised with any change of the computation that raises or lowers the table."""
_HORIZON = 2.4
"""Time up to which the table goes; later on the lost time does not decrease. A longer table does
not raise it, as what is added in each step outweighs what it gains."""
_EVERY = 3
"""Steps of the computation for one of the table."""
_RESOLUTION = 4e-5
"""Unit of the lost times that are stored, rounded down."""
_DAMAGED = (ValueError, KeyError, EOFError, BadZipFile, zlib.error)
_log = logging.getLogger("sphere_nmpc")


class DisplacementTable:
    """Lost times of a robot; times and lengths in the units of docs/time_bound.md.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Ascending, from zero.
    """

    def __init__(
        self, grid: OrientationGrid, times: Vector, at_cap: Vector, stored: NDArray[np.int16]
    ) -> None:
        self.times = times
        self._grid = grid
        self._at_cap = at_cap
        self._stored = stored

    def lost(self, quaternion: Vector, heading: float) -> Vector:
        """Return the least lost time [1 / (c1 u_max)] at each of `times`, shape (n,).

        It is that on the way from an orientation in the direction of a heading [rad].
        """
        # Later on it is not less, as nothing is faster than FASTEST.
        return np.maximum.accumulate(np.maximum(self._lost(quaternion, heading), 0.0))

    def _lost(self, quaternion: Vector, heading: float) -> Vector:
        latitude, *_ = angles = angles_of(quaternion, heading)
        rows, longitudes, turns = self._grid.shape
        if latitude >= (rows - 1) * self._grid.step:
            return self._at_cap
        place = angles / self._grid.step - 0.5
        node = np.floor(place + 0.5).astype(int)
        offset = place - node
        before, after = 0.5 - offset, 0.5 + offset
        weights = np.array((0.5 * before**2, 0.75 - offset**2, 0.5 * after**2))
        total = np.zeros(len(self.times))
        for shift in np.ndindex(3, 3, 3):
            row, longitude, turn = node + shift - 1
            if row < 0:
                row, longitude = -1 - row, -1 - longitude
            stored = self._stored[:, row, longitude % longitudes, turn % turns]
            weight = math.prod(weights[shift[axis], axis] for axis in range(3))
            total += weight * _RESOLUTION * stored
        return total

    def least_time(self, distance: float, start: Vector, goal: Vector, heading: float) -> float:
        """Return a time [1 / (c1 u_max)] in which no motion gets so far at full rotor speeds.

        The distance is in radii of the shell, start and goal are quaternions, and the heading
        from start to goal is in radian. The part of the motion after any instant is one back from
        the goal.
        """
        first, last = self.lost(start, heading), self.lost(goal, heading + math.pi)
        ways = [FASTEST * (self.times - lost) for lost in (first, last)]
        # The rest of the way is not faster than straight rolling.
        possible = ways[0][:, None] + ways[1] <= distance
        lost = np.where(possible, first[:, None] + last, 0.0)
        return distance / FASTEST + float(np.max(lost))

    def save(self, path: Path) -> None:
        """Write the table to a file, which is there as a whole or not at all."""
        own_folder(path.parent)
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=".npz")
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez(file, times=self.times, at_cap=self._at_cap, stored=self._stored)
            os.replace(name, path)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(name)
            raise

    @classmethod
    def load(cls, grid: OrientationGrid, path: Path) -> "DisplacementTable | None":
        """Return the table of a file; None if it is none of this grid."""
        with np.load(path, allow_pickle=False) as file:
            times, at_cap, stored = (file[name] for name in ("times", "at_cap", "stored"))
        if (
            times.ndim != 1 or at_cap.shape != times.shape or stored.dtype != np.int16
            or stored.shape != (len(times), *grid.shape)
        ):
            return None
        return cls(grid, times, at_cap, stored)


def computed_table(grid: OrientationGrid, horizon: float = _HORIZON) -> DisplacementTable:
    """Return the table of a grid up to a time, with a progress bar on standard error."""
    steps = DisplacementSteps(grid)
    number = math.ceil(horizon / steps.step / _EVERY)
    times, at_cap = np.zeros(number + 1), np.zeros(number + 1)
    stored = np.zeros((number + 1, *grid.shape), dtype=np.int16)
    bar = Progress(
        *Progress.get_default_columns(), console=Console(stderr=True), transient=True
    )
    limits = np.iinfo(np.int16)
    with shown(bar) as progress:
        for step in progress.track(range(1, number + 1), description="lower bound"):
            for _ in range(_EVERY):
                steps.advance()
            times[step] = steps.time
            at_cap[step] = steps.time - (steps.cap + steps.added) / FASTEST
            lost = steps.time - (steps.coefficients + steps.added) / FASTEST
            lost = np.floor(lost / _RESOLUTION)
            if not limits.min < np.min(lost):  # on a grid that is too coarse for this time
                return DisplacementTable(grid, times[:step], at_cap[:step], stored[:step])
            # Where the bound is too large for a number, a smaller one is a bound as well.
            stored[step] = np.minimum(lost, limits.max)
    return DisplacementTable(grid, times, at_cap, stored)


def displacement_table(constants: LumpedConstants) -> DisplacementTable:
    """Return the table of a robot, from memory or the cache where it is there.

    A cache that cannot be used is a warning; the table is then computed.
    """
    return _table(constants.transverse_ratio, constants.axial_ratio, SIZE)


@functools.lru_cache(maxsize=4)
def _table(transverse_ratio: float, axial_ratio: float, size: int) -> DisplacementTable:
    key = f"{_VERSION} {size} {_HORIZON!r} {_EVERY} {transverse_ratio!r} {axial_ratio!r}"
    name = hashlib.sha256(key.encode()).hexdigest()[:24]
    path = cache_folder() / f"displacement_{name}.npz"
    grid = OrientationGrid(size, transverse_ratio, axial_ratio)
    # A damaged file is replaced; reading anything but a regular file might never end.
    with contextlib.suppress(OSError, *_DAMAGED):
        own_folder(path.parent)
        if path.is_file():
            table = DisplacementTable.load(grid, path)
            if table is not None:
                return table
    table = computed_table(grid)
    try:
        table.save(path)
    except OSError as error:
        _log.warning(
            "sphere_nmpc study: %s cannot be written (%s); the table of lower bounds is not kept, "
            "and computed again next time", path, error.strerror or error,
        )
    return table
