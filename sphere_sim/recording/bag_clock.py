# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The time of a run, from the two clocks of its bag: log times and stamps."""

from collections.abc import Sequence

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_sim.recording.stamps import NANOSECONDS

_SLACK = 1.0
"""How far a stamp and the arrival of its message may be apart, on either clock [s]."""
_OTHER_CLOCK = 1e8
"""A stamp this much older than its arrival is of another clock [s]: between simulated time and
that of the system lie 1.8e9 s, and no simulation runs for three years."""


def longest_run(stamps: Sequence[int]) -> slice:
    """Return which of some poses belong together as the longest run.

    Parameters
    ----------
    stamps : sequence of int, length n > 0
        Stamps of the poses [ns] in order of arrival. Where they go back by more than latency can
        do, a simulator was started again.
    """
    fresh = np.flatnonzero(np.diff(np.array(stamps)) < -_SLACK * NANOSECONDS) + 1
    edges = [0, *(int(i) for i in fresh), len(stamps)]
    longest = int(np.argmax(np.diff(edges)))
    return slice(edges[longest], edges[longest + 1])


class BagClock:
    """Converts stamps and log times of a bag to seconds since the first pose's stamp.

    ``ros2 bag record`` logs by the system's clock while stamps are in simulated time, which may
    be faster, slower or stand still, so the two must never be compared. What ties them together
    are the poses, that have both.

    Parameters
    ----------
    received : sequence of int, length n > 0
        Log times of the poses [ns], in any order.
    stamps : sequence of int, length n
        Their stamps [ns].
    """

    def __init__(self, received: Sequence[int], stamps: Sequence[int]) -> None:
        self.origin = min(stamps)
        """Stamp of the run's first pose [ns]."""
        self._first = min(received)
        pairs = sorted(zip(received, stamps, strict=True), key=lambda pair: pair[0])
        logs = np.array([(log - self._first) / NANOSECONDS for log, _ in pairs])
        # A pose that was overtaken by a newer one does not turn time back.
        times = np.maximum.accumulate([self.time(stamp) for _, stamp in pairs])
        # Many poses have one log time where the recorder's clock was late, or stood still.
        self._logs, first = np.unique(logs, return_index=True)
        self._earliest = times[first]
        self._latest = times[np.append(first[1:], len(times)) - 1]

    def time(self, stamp: int) -> float:
        """Return the time [s] of a stamp [ns] of the poses' clock."""
        return (stamp - self.origin) / NANOSECONDS

    def heard(self, received: int) -> float:
        """Return the time [s] at which a message was logged, from its log time [ns].

        Between poses it is interpolated, and of several poses at once the first counts; before
        the first and after the last one the clocks are taken to run alike.
        """
        return self._between(received, self._earliest)

    def _between(self, received: int, times: Vector) -> float:
        log = (received - self._first) / NANOSECONDS
        if log > self._logs[-1]:
            return float(self._latest[-1] + log - self._logs[-1])
        return float(np.interp(log, self._logs, times)) + min(log, 0.0)

    def told(self, stamp: int, received: int, *, kept: bool = False) -> float:
        """Return the time [s] of a message that has a stamp, which may be of another clock.

        Parameters
        ----------
        stamp : int
            What the message says [ns].
        received : int
            Its log time [ns].
        kept : bool
            Whether publishers keep such messages for late subscribers, so that an old stamp is to
            be believed.

        Returns
        -------
        float
            That of the stamp, if it can be of the poses' clock, else when it was logged. A stamp
            of 0 is of a sender without a clock, or of one that still stands at 0: it is believed
            where that is about now.
        """
        slack = round(_SLACK * NANOSECONDS)
        earliest = self.heard(received - slack) - _SLACK
        if kept and stamp:
            earliest = self.heard(received) - _OTHER_CLOCK
        time = self.time(stamp)
        latest = self._between(received + slack, self._latest) + _SLACK
        return time if earliest <= time <= latest else self.heard(received)
