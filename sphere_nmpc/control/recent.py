# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Newest values of a stream: their mean and quantiles."""

import math
from collections import deque


class Recent:
    """Newest values of a stream, at most `window` of them."""

    def __init__(self, window: int) -> None:
        self._values: deque[float] = deque(maxlen=window)

    def __len__(self) -> int:
        return len(self._values)

    @property
    def is_full(self) -> bool:
        """Whether the window is filled."""
        return len(self._values) == self._values.maxlen

    @property
    def mean(self) -> float:
        """Mean of the values; nan without any."""
        return sum(self._values) / len(self._values) if self._values else math.nan

    def add(self, value: float) -> None:
        """Add the newest value; nan, which tells nothing, is left out."""
        if not math.isnan(value):
            self._values.append(value)

    def clear(self) -> None:
        """Forget all values."""
        self._values.clear()

    def quantile(self, share: float) -> float:
        """Return the value below which this share of the values lies; nan without any.

        Between two values it is interpolated: 0 is the least one, 1 the largest.
        """
        if not self._values:
            return math.nan
        ordered, place = sorted(self._values), share * (len(self._values) - 1)
        below = math.floor(place)
        above = min(below + 1, len(ordered) - 1)
        return ordered[below] + (place - below) * (ordered[above] - ordered[below])
