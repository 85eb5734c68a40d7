# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Stamps of measurements, and which of them cannot be times of measurement."""

import math
import time

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.reporting.recent import Recent

OTHER_CLOCK_AGE = 1e6
"""Age of a message beyond which its stamp is of another kind of clock, not merely late [s]."""
SHORT_GAP = 0.1
"""Share of the mean spacing of measurements [-] below which two are of a bunch."""
_MIN_SHARE_OF_GAPS = 0.2
"""Share of the gaps that has to be wrong for it."""
_MIN_STAMP_DEVIATION = 2e-3
"""Standard deviation of the stamps from which on it is reported [s]: 1.5 mm at full speed for the
robot of Table 1."""
_MIN_DURATION = 3.0
"""Control time for which that has to last [s]: a change of noise or slope looks like it for up to
0.8 s, until it is known."""


class StampWatch:
    """Monitor of the messages of a source: since when there are none, and their stamps.

    `plural` names what is measured.
    """

    def __init__(self, plural: str = "poses") -> None:
        self._plural = plural
        self.seen_at = time.monotonic()
        """Wall time of the last check before which there were messages [s]."""
        self.age, self.has_stamp = math.nan, True
        """Age nearest to 0 [s] of those before that check, one of which has a stamp other than 0:
        of another clock are those whose stamps are all wrong."""
        self.reported = ""
        """What the node that publishes them reports as wrong."""
        self._is_heard = False
        self._newest: tuple[float, NDArray[np.float64]] = (math.nan, np.empty(0))
        self._gaps = Recent()
        self._deviation, self._exact_at = 0.0, math.inf
        """What is reported [s], and the last time at which there was nothing to report [s]."""

    def heard(self, age: float, stamp: int) -> None:
        """Record a message with a stamp [ns], `age` behind the clock [s]; nan if unknown."""
        if not self._is_heard:
            self._is_heard, self.age, self.has_stamp = True, age, stamp != 0
            return
        self.has_stamp = self.has_stamp or stamp != 0
        if not abs(age) >= abs(self.age):
            self.age = age

    def checked(self, wall: float) -> None:
        """Begin anew at a check, at wall time `wall` [s]."""
        if self._is_heard:
            self._is_heard, self.seen_at = False, wall

    def received(self, stamp: float, measured: NDArray[np.float64]) -> None:
        """Record what was measured, and its stamp [s]; a copy of the one before counts as it."""
        (before, same), self._newest = self._newest, (stamp, measured)
        if stamp > before or (stamp == before and not np.array_equal(measured, same)):
            self._gaps.append(stamp - before)

    def moved(self, time: float, deviation: float) -> None:
        """Record the standard deviation of the stamps [s] that motion has shown at a time [s]."""
        if not (deviation >= _MIN_STAMP_DEVIATION and time >= self._exact_at):
            self._exact_at = time
        self._deviation = deviation if time >= self._exact_at + _MIN_DURATION else 0.0

    def fault(self) -> Condition | None:
        """Return what is wrong with the stamps, and the remedy; None if nothing is."""
        gaps = np.array(self._gaps) if self._gaps.is_full else np.empty(0)
        count = max(1, gaps.size)
        mean = float(np.sum(gaps)) / count
        short = SHORT_GAP * mean
        same, close = (float(np.sum(gaps <= most)) / count for most in (0.0, short))
        if same > _MIN_SHARE_OF_GAPS:
            return Condition(
                Kind.INEXACT_STAMPS,
                f"given {100.0 * same:.0f} % of the {self._plural} with the same stamp as the one "
                "before, expected the time of measurement of each: is the clock that stamps them "
                "coarse? All but the first are dropped",
            )
        if close > _MIN_SHARE_OF_GAPS:
            return Condition(
                Kind.INEXACT_STAMPS,
                f"given {100.0 * close:.0f} % of the {self._plural} less than {1e3 * short:.2g} "
                f"ms after the one before, at {1.0 / mean:.3g} Hz, expected the times of "
                f"measurement: {self._plural} are stamped where they are measured, not where "
                "bunches of them are passed on",
            )
        if not self._deviation:
            return None
        return Condition(
            Kind.INEXACT_STAMPS,
            f"given poses whose stamps are off by about {1e3 * self._deviation:.2g} ms, by the "
            "motion that they show, expected the times of measurement: stamp them where they are "
            "measured, by the clock of this node",
        )
