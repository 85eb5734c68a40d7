# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Delay and loss of poses on their way, as far as their stamps show them."""

import math
from collections import deque

import numpy as np

_KEPT = 256
"""Newest poses that delay and loss are taken of."""


class PoseLink:
    """Statistics of the newest poses. Times are control times [s]."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=_KEPT)
        self._ages: deque[float] = deque(maxlen=_KEPT)

    def received(self, time: float, age: float) -> None:
        """Record a pose measured at `time` [s], which is `age` old; nan if that is unknown."""
        if self._times and time <= self._times[-1]:
            if time > self._times[0]:
                return  # Overtaken by a newer one.
            self._times.clear()
            self._ages.clear()
        self._times.append(time)
        self._ages.append(age)

    @property
    def delay(self) -> float:
        """Mean age of the poses when they were received [s]; nan if unknown.

        Where the clock is a topic, it is delayed as well, so that the age shows the difference.
        """
        known = [age for age in self._ages if not math.isnan(age)]
        return sum(known) / len(known) if known else math.nan

    @property
    def loss(self) -> float:
        """Share of poses that were not received, from the gaps between stamps; nan if unknown."""
        if len(self._times) < 3:
            return math.nan
        gaps = np.diff(self._times)
        missing = float(np.sum(np.maximum(0.0, np.round(gaps / np.median(gaps)) - 1.0)))
        return missing / (missing + gaps.size)
