# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Memory of the rotor speeds that were really sent, to predict what the robot did meanwhile."""

from collections import deque

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.integrator import DEFAULT_MAX_STEP
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.solver.roll_out import roll_out

_KEPT = 2048
"""Holds remembered: two seconds at the highest control rate, a quarter of an hour at 2 Hz."""
_SHORTEST = 1e-6
"""Spacing of bends that count as one [s]."""
_MANY = 48
"""Pieces beyond which straight runs of them are joined ..."""
_STRAIGHT = 0.05
"""... if no end between them is further than this from the straight line [rad/s]."""


class SentInputs:
    """Holds in the order in which they took effect; each lasts until the next one.

    Times are control times [s].
    """

    def __init__(self) -> None:
        self._holds: deque[FirstOrderHold] = deque(maxlen=_KEPT)

    def clear(self) -> None:
        """Forget everything; the rotors count as at rest."""
        self._holds.clear()

    def record(self, hold: FirstOrderHold) -> None:
        """Remember a hold that takes effect at its first knot; it replaces what comes later."""
        while self._holds and self._holds[-1].start >= hold.start:
            self._holds.pop()
        self._holds.append(hold)

    def copy(self) -> "SentInputs":
        """Return what is remembered now, to be looked at in another thread."""
        twin = SentInputs()
        twin._holds.extend(self._holds)
        return twin

    @property
    def newest(self) -> FirstOrderHold | None:
        """The hold in force, None before the first."""
        return self._holds[-1] if self._holds else None

    def at(self, time: float) -> Vector:
        """Return the speeds in force at `time` [rad/s], shape (2,); zero before the first."""
        for hold in reversed(self._holds):
            if hold.start <= time + 1e-9:
                return hold.at(time)
        return np.zeros(INPUT_SIZE)

    def leading_to(self, hold: FirstOrderHold, now: float) -> FirstOrderHold:
        """Return what is followed from `now` on [s] when `hold` is sent.

        Until a hold begins, what is in force goes on, with its bends: the hold was planned from
        where that leads. One that has begun is joined at its next knot.
        """
        joined = hold.starting_at(now, self.at(now))
        newest = self.newest
        if newest is None:
            return joined
        bends = _between(newest, now + _SHORTEST, hold.start - _SHORTEST)
        if not bends:
            return joined
        speeds = np.array([newest.at(t) for t in bends])
        return FirstOrderHold(
            np.insert(joined.times, 1, bends), np.insert(joined.speeds, 1, speeds, axis=0)
        )

    def predict(
        self,
        state: Vector,
        start: float,
        end: float,
        constants: Vector,
        max_step: float = DEFAULT_MAX_STEP,
    ) -> Vector:
        """Return the state at `end`, shape (6,), given the one at `start` and what was sent.

        Parameters
        ----------
        state : ndarray, shape (6,)
            State at `start`.
        start, end : float
            Control times [s]; nothing happens where `end` is not later.
        constants : ndarray, shape (4,)
            Lumped constants [Rs, c1, r1, r3].
        max_step : float, optional
            Longest integration step [s].
        """
        times: list[float] = []
        speeds: list[Vector] = []
        for hold, since, until in self._in_force(start, end):
            # Where one hold takes over from another the speed may jump: two ends at one time.
            here = [since, *_between(hold, since, until), until]
            times += here
            speeds += [hold.at(t) for t in here]
        if not times:
            return state
        predicted: Vector = roll_out(
            state, np.array(speeds), np.diff(times), constants, max_step
        )[-1]
        return predicted

    def pieces(self, start: float, end: float) -> tuple[Vector, Vector]:
        """Return the straight pieces of what was sent between two times.

        Parameters
        ----------
        start, end : float
            Control times [s], `end` the later one; before the first hold the rotors rested.

        Returns
        -------
        durations : ndarray, shape (K,)
            Lengths of the pieces [s].
        speeds : ndarray, shape (K + 1, 2)
            Rotor speeds at their ends [rad/s].
        """
        ends: dict[float, Vector] = {start: self.at(start)}
        for hold, since, until in self._in_force(start, end):
            for t in (since, *_between(hold, since, until)):
                ends[t] = hold.at(t)
        ends[end] = self.at(end)
        times, speeds = np.array(list(ends)), np.array(list(ends.values()))
        if times.size > _MANY:
            kept = _corners(times, speeds)
            times, speeds = times[kept], speeds[kept]
        return np.diff(times), speeds

    def moves_after(self, time: float) -> bool:
        """Return whether the hold in force asks for any speed at `time` [s] or later."""
        newest = self.newest
        if newest is None:
            return False
        return bool(newest.at(time).any() or newest.speeds[newest.times > time].any())

    def _in_force(self, start: float, end: float) -> list[tuple[FirstOrderHold, float, float]]:
        """Return what was in force between two times, in order, with since when and until when."""
        found: list[tuple[FirstOrderHold, float, float]] = []
        # From the newest back, so that a long memory costs nothing.
        for hold in reversed(self._holds):
            if end <= start:
                break
            if hold.start < end:
                since = max(start, hold.start)
                found.append((hold, since, end))
                end = since
        return found[::-1]


def _between(hold: FirstOrderHold, since: float, until: float) -> list[float]:
    """Return the times of a hold's knots strictly between two times [s]."""
    return [t for t in hold.times.tolist() if since < t < until]


def _corners(times: Vector, speeds: Vector) -> list[int]:
    """Return the indices of the ends that a line must go through to stay near all of them."""
    kept, last = [0], 0
    for i in range(2, times.size):
        share = (times[last + 1 : i] - times[last]) / (times[i] - times[last])
        line = speeds[last] + share[:, None] * (speeds[i] - speeds[last])
        if np.abs(speeds[last + 1 : i] - line).max() > _STRAIGHT:
            last = i - 1
            kept.append(last)
    return [*kept, times.size - 1]
