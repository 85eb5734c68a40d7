# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Series of a run: the values of one quantity over time, and those that every run has."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model.state import Vector

_SAME_INSTANT = 0.5e-9
"""Difference up to which two times are the same [s], as some are read from text: stamps are in
nanoseconds."""


@dataclass(frozen=True, eq=False)
class Series:
    """Values of one quantity over time.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Ascending times [s].
    values : ndarray of n rows, or tuple of n
        Values of any type at these times.
    lasting : bool
        Whether each is in force until the next one, as goals and floors are.
    """

    times: Vector = field(default_factory=lambda: np.empty(0))
    values: Any = ()
    lasting: bool = False

    @classmethod
    def of(cls, entries: Iterable[tuple[float, Any]], lasting: bool = False) -> "Series":
        """Return the series of times [s] and values of any type."""
        known = list(entries)
        return cls(np.array([time for time, _ in known]), tuple(it for _, it in known), lasting)

    @classmethod
    def of_numbers(cls, times: Vector, rows: Vector) -> "Series":
        """Return the series of numbers, shape (n, k), at times [s] in any order.

        Of those at equal times the first counts.
        """
        ascending, first = np.unique(times, return_index=True)
        return Series(ascending, rows[first])

    def __len__(self) -> int:
        return self.times.size

    def newest(self, time: float) -> int:
        """Return the index of the newest value at a time [s]; -1 before the first one."""
        return int(np.searchsorted(self.times, time, side="right")) - 1

    def at(self, time: float, before: Any = None) -> Any:
        """Return the newest value at a time [s]; `before` where there is none yet."""
        index = self.newest(time)
        return self.values[index] if index >= 0 else before

    def between(self, start: float, end: float) -> "Series":
        """Return what was measured or in force from `start` until before `end`, since `start`."""
        since, until = start - _SAME_INSTANT, end - _SAME_INSTANT
        kept = (self.times >= since) & (self.times < until)
        if self.lasting and self.newest(start) >= 0:
            kept[self.newest(start)] = True
        return replace(self.where(kept), times=self.times[kept] - start)

    def where(self, kept: NDArray[np.bool_]) -> "Series":
        """Return the part in which a mask, shape (n,), holds."""
        values = self.values
        if isinstance(values, tuple):
            return replace(self, times=self.times[kept],
                           values=tuple(values[i] for i in np.flatnonzero(kept)))
        return replace(self, times=self.times[kept], values=values[kept])

    def during(self, times: Vector) -> Iterator[tuple[Any, NDArray[np.bool_]]]:
        """Yield each value, and at which of other times [s] it is in force."""
        which = np.searchsorted(self.times, times, side="right") - 1
        for i, value in enumerate(self.values):
            yield value, which == i

    def interpolated(self, times: Vector, outside: float | None = None) -> Vector:
        """Return the values, shape (n, k), at other times [s], linear between them.

        Outside of the series they are those at its ends, or what is given.
        """
        if not len(self):
            return np.full((len(times), self.values.shape[1]), np.nan)
        return np.column_stack([
            np.interp(times, self.times, column, outside, outside) for column in self.values.T
        ])

    def column(self, name: str) -> Vector:
        """Return an attribute of the values, numbers, shape (n,)."""
        return np.array([getattr(value, name) for value in self.values], dtype=float)


@dataclass(frozen=True, eq=False)
class RobotSeries:
    """Measured series of a run.

    Attributes
    ----------
    poses : Series
        Poses, shape (6,).
    rotor_speeds, rotor_torques : Series
        Those of both rotors [rad/s], [N m], shape (2,); nan where not recorded.
    """

    poses: Series
    rotor_speeds: Series
    rotor_torques: Series

    @property
    def times(self) -> Vector:
        """Times of the poses [s]."""
        return self.poses.times

    @property
    def states(self) -> Vector:
        """Poses, shape (n, 6)."""
        return np.asarray(self.poses.values)
