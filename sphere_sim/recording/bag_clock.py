# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time of a recorded run, from the two clocks of its bag: log times and message stamps."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import NANOSECONDS

TOLERANCE = 1.0
"""Largest plausible time between a stamp and the log time of its message, on either clock [s]."""
OTHER_CLOCK = 1e8
"""Age from which on a stamp is attributed to another clock [s]: simulated time and system time
differ by 1.8e9 s, and no simulation runs for three years."""

_LEAST_RATE = 1e-3
"""Least rate of simulated time that is plausible, as a multiple of that of the log times."""
_MOST_STANDING = 0.6
"""Share of steps without progress that stamps may have, as where each is given twice."""


def stand_still(
    logs: NDArray[np.int64], stamps: NDArray[np.int64], values: Vector
) -> bool:
    """Return whether stamps [ns] do not advance as a time does, as constants and whole seconds.

    `logs` are the log times [ns], `values` what the messages hold, shape (n, k): while simulated
    time is paused, it is the same. If it always is, all messages count that are logged apart.
    """
    kept = np.nan_to_num(values)
    changes = np.any(kept[1:] != kept[:-1], axis=1)
    # Where the log times stand as well, it is the recorder's clock that does.
    apart = np.diff(logs) > 0
    changes = changes & apart if np.any(changes) else apart
    steps, passed = np.diff(stamps)[changes], np.diff(logs)[changes]
    standing = np.abs(steps) <= _LEAST_RATE * passed
    return bool(standing.size and np.mean(standing) > _MOST_STANDING)


def longest_run(stamps: Sequence[int] | NDArray[np.int64]) -> slice:
    """Return the longest section of poses, by their stamps [ns], without a restart.

    Stamps that go back by more than latency explains indicate a restart of the simulator.
    """
    restarts = np.flatnonzero(np.diff(stamps) < -TOLERANCE * NANOSECONDS) + 1
    edges = [0, *(int(i) for i in restarts), len(stamps)]
    longest = int(np.argmax(np.diff(edges)))
    return slice(edges[longest], edges[longest + 1])


class BagClock:
    """Conversion of stamps and log times of a bag to seconds since the stamp of the first pose.

    ``ros2 bag record`` logs messages by the system clock while stamps are in simulated time, which
    may be faster, slower or paused, so the two must never be compared directly. The poses, which
    have both times, relate the two clocks: `received` and `stamps` are their log times and stamps
    [ns], in any order.
    """

    def __init__(self, received: Sequence[int], stamps: Sequence[int]) -> None:
        self.undated: Counter[str] = Counter()
        """Messages of each topic whose stamps could not be used."""
        self.origin = min(stamps)
        """Stamp of the first pose of the run [ns]."""
        self._first = min(received)
        pairs = sorted(zip(received, stamps, strict=True), key=lambda pair: pair[0])
        logs = np.array([(log - self._first) / NANOSECONDS for log, _ in pairs])
        # Poses that arrive out of order must not make time go back.
        times = np.maximum.accumulate([self.time_of_stamp(stamp) for _, stamp in pairs])
        # Many poses share a log time where the recorder's clock was late or paused.
        self._logs, first = np.unique(logs, return_index=True)
        self._earliest = times[first]
        self._latest = times[np.append(first[1:], len(times)) - 1]

    def time_of_stamp(self, stamp: int) -> float:
        """Return the time [s] of a stamp [ns] of the clock of the poses."""
        return (stamp - self.origin) / NANOSECONDS

    def time_of_log(self, received: int) -> float:
        """Return the time [s] at which a message was logged, from its log time [ns].

        Between poses the time is interpolated, from the first of several poses with equal log
        time; before the first and after the last pose both clocks are assumed to run equally fast.
        """
        return self._interpolate(received, self._earliest)

    def time_of_message(self, stamp: int, received: int, *, latched: bool = False) -> float:
        """Return the time [s] of a message whose stamp may be of another clock.

        It is the time of the stamp [ns], if that is plausible for the clock of the poses, else
        that of the log time `received` [ns]. Plausible are all times of the run: how late a
        message is logged says nothing, as a simulation that is as fast as possible does not wait
        for its recorder. Of a `latched` topic, whose publishers keep messages for late
        subscribers, old stamps are plausible, too. A stamp of 0 comes from a sender without a
        clock, or one whose clock has not started: it is used only if the run is near its time 0.
        """
        tolerance = round(TOLERANCE * NANOSECONDS)
        near = self.time_of_log(received - tolerance)
        earliest = (min(near, 0.0) if stamp else near) - TOLERANCE
        if latched and stamp:
            earliest = self.time_of_log(received) - OTHER_CLOCK
        time = self.time_of_stamp(stamp)
        near = self._interpolate(received + tolerance, self._latest)
        latest = max(near, float(self._latest[-1])) + TOLERANCE
        return time if earliest <= time <= latest else self.time_of_log(received)

    def time_of_record(
        self, topic: str, received: int, record: Any, *, latched: bool = False
    ) -> float:
        """Return the time [s] of the record of a message, see `time_of_message`."""
        time = self.time_of_message(record.stamp, received, latched=latched)
        self.undated[topic] += time != self.time_of_stamp(record.stamp)
        return time

    def notes(self, whose: str) -> list[str]:
        """Return a note on each topic that is undated, by this clock of the poses or the IMU."""
        return [
            f"{topic}: {count} stamps are not of the clock of {whose}; the log times are used"
            for topic, count in self.undated.items() if count
        ]

    def _interpolate(self, received: int, times: Vector) -> float:
        log = (received - self._first) / NANOSECONDS
        if log > self._logs[-1]:
            return float(self._latest[-1] + log - self._logs[-1])
        return float(np.interp(log, self._logs, times)) + min(log, 0.0)
