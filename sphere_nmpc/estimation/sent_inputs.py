# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""History of the rotor speeds sent."""

import math
from collections import deque

import numpy as np

from sphere_nmpc.model.first_order_hold import SAME, SHORTEST, FirstOrderHold
from sphere_nmpc.model.state import INPUT_SIZE, Vector

_KEPT = 2048
"""Holds remembered: two seconds at the highest control rate, a quarter of an hour at 2 Hz."""
LONGEST_WINDOW = 0.3
"""Largest commitment window [s]: later commands count as lost, and after as long without measured
speeds none are awaited."""


class SentInputs:
    """Holds in the order in which they took effect; each lasts until the next one.

    They are kept as they were sent, and as measured rotor speeds correct them. What is read is the
    former, until these speeds have followed a command, or poses show that they explain the motion
    better; where poses show the opposite it is the former again, see `judge`.

    Times are control times [s].
    """

    def __init__(self) -> None:
        self._sent: deque[FirstOrderHold] = deque(maxlen=_KEPT)
        self._corrected: deque[FirstOrderHold] = deque(maxlen=_KEPT)
        self._holds = self._sent
        self._doubt = 0.0
        """Twice the log of the odds that the corrections are wrong."""
        self.contradicted = False
        """Whether the motion contradicts the measured rotor speeds."""
        self.known_until = float("-inf")
        """Time of the newest measured rotor speeds that confirmed or corrected the holds [s]."""

    def clear(self) -> None:
        """Discard all holds; the rotors count as at rest."""
        self._sent.clear()
        self._corrected.clear()
        self.known_until = float("-inf")

    def record(self, hold: FirstOrderHold) -> None:
        """Add a hold that takes effect at its first knot and replaces what was sent for later."""
        for holds in (self._sent, self._corrected):
            while holds and holds[-1].start >= hold.start:
                holds.pop()
            holds.append(hold)

    def withdraw(self, hold: FirstOrderHold) -> None:
        """Correct by a hold that did not take effect; the one before it lasts longer."""
        for i in range(len(self._corrected) - 1, -1, -1):
            if self._corrected[i] is hold:
                del self._corrected[i]
                return

    def follow(
        self, hold: FirstOrderHold, known: list[tuple[float, Vector]], acceleration: float
    ) -> None:
        """Correct by a hold that took effect late and is not in force yet.

        `known` are times [s] and the rotor speeds then [rad/s], shape (2,), first those at which
        the hold before was left; then the rotors catch up, within `acceleration` [rad/s^2].
        """
        time, speeds = known[-1]
        corrected = self._corrected
        rest = hold.starting_at(time, speeds).limited(np.inf, acceleration)
        times, before = zip(*known[:-1], strict=True)
        followed = FirstOrderHold(
            np.concatenate((times, rest.times)), np.vstack((*before, rest.speeds))
        )
        earlier = [kept for kept in corrected if kept.start < followed.start]
        later = [kept for kept in corrected if kept.start > time]
        corrected.clear()
        corrected.extend((*earlier, followed, *later))

    def confirm(self) -> None:
        """Believe the measured speeds, which have followed a command, unless poses show more."""
        if self._doubt == 0.0:
            self._holds = self._corrected

    @property
    def believes_measured(self) -> bool:
        """Whether what is read is corrected by the measured speeds."""
        return self._holds is self._corrected

    def judge(self, as_sent: float, as_corrected: float, improbable: float) -> None:
        """Take into account how far a motion was from its prediction by the speeds of each kind.

        Given are normalised squares of innovations with 5 degrees of freedom. The scale of the
        errors is not known, so that -2 log of the ratio of likelihoods is 5 log of that of the
        mean squares, 1 being that of noise alone. The ratios of intervals multiply, up to odds of
        `improbable`; once these are reached the one or the other is believed, until the opposite
        ones are (a sequential test). A motion for which both are the same halves the odds that
        the corrections are wrong.
        """
        more = 5.0 * math.log((5.0 + as_corrected) / (5.0 + as_sent))
        if more:
            self._doubt = min(max(self._doubt + more, -improbable), improbable)
        elif self._doubt > 0.0:
            self._doubt = max(self._doubt - 2.0 * math.log(2.0), 0.0)
        self.contradicted = self._doubt == improbable or (self.contradicted and self._doubt > 0.0)
        if abs(self._doubt) == improbable:
            self._holds = self._sent if self.contradicted else self._corrected

    def is_pending(self, time: float, now: float) -> bool:
        """Return whether measured speeds will show soon what the rotors did up to `time` [s].

        Not if none were received for a while at `now` [s].
        """
        return now - LONGEST_WINDOW < self.known_until < time - SHORTEST

    @property
    def newest(self) -> FirstOrderHold | None:
        """The hold in force, None before the first."""
        return self._holds[-1] if self._holds else None

    def at(self, time: float) -> Vector:
        """Return the speeds in force at `time` [rad/s], shape (2,); zero before the first."""
        for hold in reversed(self._holds):
            if hold.start <= time + SAME:
                return hold.at(time)
        return np.zeros(INPUT_SIZE)

    def leading_to(self, hold: FirstOrderHold, now: float) -> FirstOrderHold:
        """Return the speeds from `now` on [s] if `hold` is sent.

        Until the hold begins, the one in force is followed with all its knots, as the plan
        assumed. A hold that has begun already is joined at its next knot.
        """
        joined = hold.starting_at(now, self.at(now))
        newest = self.newest
        if newest is None:
            return joined
        knots = newest.knots_between(now + SHORTEST, hold.start - SHORTEST)
        if not knots:
            return joined
        speeds = np.array([newest.at(t) for t in knots])
        return FirstOrderHold(
            np.insert(joined.times, 1, knots), np.insert(joined.speeds, 1, speeds, axis=0)
        )

    def pieces(self, start: float, end: float) -> tuple[Vector, Vector]:
        """Return the speeds sent from `start` to `end` [s], which is later, as straight pieces.

        That is their lengths [s], shape (K,), and the rotor speeds at their ends [rad/s], shape
        (K + 1, 2). Before the first hold the rotors are at rest.
        """
        return _pieces(self._holds, start, end)

    def both_pieces(
        self, start: float, end: float
    ) -> tuple[tuple[Vector, Vector], tuple[Vector, Vector]]:
        """Return the pieces by what was sent, and by what measured speeds make of it."""
        return _pieces(self._sent, start, end), _pieces(self._corrected, start, end)

    def moves_after(self, time: float) -> bool:
        """Return whether the hold in force has a speed other than zero at `time` [s] or later."""
        newest = self.newest
        if newest is None:
            return False
        return bool(newest.at(time).any() or newest.speeds[newest.times > time].any())


def _pieces(holds: deque[FirstOrderHold], start: float, end: float) -> tuple[Vector, Vector]:
    """Return the speeds by holds as straight pieces, see `SentInputs.pieces`."""
    times, speeds = [end], list[Vector]()
    at_start: Vector = np.zeros(INPUT_SIZE)
    # From the newest back, so that a long history costs nothing.
    for hold in reversed(holds):
        begun, until = hold.start, times[-1]
        if begun > end + SAME:
            continue
        speeds = speeds or [hold.at(end)]
        since = max(start, begun)
        if since < until:
            knots = [*reversed(hold.knots_between(since, until)), since]
            times += knots
            speeds += map(hold.at, knots)
        if begun <= start + SAME:
            at_start = speeds[-1]
            break
    if times[-1] > start:
        times.append(start)
        speeds = [*(speeds or [at_start]), at_start]
    return np.diff(times[::-1]), np.array(speeds[::-1])
