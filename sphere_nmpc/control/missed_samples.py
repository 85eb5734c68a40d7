# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Share of the sampling instants that pass without a plan, where that goes on for seconds."""

from collections import deque
from itertools import pairwise

_SPACING = 1.0
"""Least wall time between two readings [s]."""
_INTERVALS = 5
"""Intervals between readings over which the share is taken."""
_MANY, _FEW = 0.1, 0.02
"""Share of missed instants at which it begins to be reported, and at which that ends."""


class MissedSamples:
    """Monitor of missed sampling instants; a single gap, as at a slow start, does not count."""

    def __init__(self) -> None:
        self._readings: deque[tuple[float, int, int]] = deque(maxlen=_INTERVALS + 1)
        self.share = 0.0
        """Share of the instants missed lately; 0 unless some were missed in each interval, and
        `_MANY` of all."""

    @property
    def span(self) -> float:
        """Wall time over which the share is taken [s]."""
        return self._readings[-1][0] - self._readings[0][0]

    def read(self, wall: float, used: int, missed: int) -> None:
        """Take the numbers of instants with and without a plan so far, at wall time `wall` [s]."""
        readings = self._readings
        if readings and wall < readings[-1][0] + _SPACING:
            return
        readings.append((wall, used, missed))
        gained = readings[-1][2] - readings[0][2]
        share = gained / max(1, gained + readings[-1][1] - readings[0][1])
        if self.share:
            self.share = share if share >= _FEW else 0.0
            return
        counts = [count for _, _, count in readings]
        steady = len(counts) > _INTERVALS and all(
            later > earlier for earlier, later in pairwise(counts)
        )
        self.share = share if steady and share >= _MANY else 0.0
