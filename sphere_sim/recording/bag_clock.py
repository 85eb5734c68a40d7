# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The time of a run, from the two clocks of its bag: log times and stamps."""

from collections.abc import Sequence

import numpy as np

_NANO = 1e-9
_SLACK = 1.0
"""How far a stamp and the arrival of its message may be apart, on either clock [s]."""
_OTHER_CLOCK = 1e8
"""A stamp this much older than its arrival is of another clock [s]: between simulated time and
that of the system lie 1.8e9 s, and no simulation runs for three years."""


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
        logs = np.array([(log - self._first) * _NANO for log, _ in pairs])
        # A pose that was overtaken by a newer one does not turn time back.
        times = np.maximum.accumulate([self.time(stamp) for _, stamp in pairs])
        # Of poses logged at one time the first counts: what came with them came before the others.
        self._logs, first = np.unique(logs, return_index=True)
        self._times = times[first]

    def time(self, stamp: int) -> float:
        """Return the time [s] of a stamp [ns] of the poses' clock."""
        return (stamp - self.origin) * _NANO

    def heard(self, received: int) -> float:
        """Return the time [s] at which a message was logged, from its log time [ns].

        Between poses it is interpolated; before the first and after the last one the clocks are
        taken to run alike.
        """
        log = (received - self._first) * _NANO
        inside = float(np.clip(log, self._logs[0], self._logs[-1]))
        return float(np.interp(inside, self._logs, self._times)) + log - inside

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
        slack = round(_SLACK / _NANO)
        earliest = self.heard(received - slack) - _SLACK
        if kept and stamp:
            earliest = self.heard(received) - _OTHER_CLOCK
        time = self.time(stamp)
        believed = earliest <= time <= self.heard(received + slack) + _SLACK
        return time if believed else self.heard(received)
