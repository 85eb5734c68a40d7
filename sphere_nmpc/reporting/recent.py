# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Newest values of a stream: their mean and quantiles."""

import math
from collections import deque

RECENT = 32
"""Number of values that a statistic is taken of, where its user has no reason for another."""


class Recent(deque[float]):
    """Newest values of a stream, at most `window` of them."""

    def __init__(self, window: int = RECENT) -> None:
        super().__init__(maxlen=window)

    @property
    def is_full(self) -> bool:
        """Whether the window is filled."""
        return len(self) == self.maxlen

    @property
    def mean(self) -> float:
        """Mean of the values; nan without any."""
        return sum(self) / len(self) if self else math.nan

    def quantile(self, share: float) -> float:
        """Return the value below which this share of the values lies; nan without any.

        Between two values it is interpolated: 0 is the least one, 1 the largest. Values that
        are nan do not count.
        """
        ordered = sorted(value for value in self if value == value)
        if not ordered:
            return math.nan
        place = share * (len(ordered) - 1)
        below = math.floor(place)
        above = min(below + 1, len(ordered) - 1)
        return ordered[below] + (place - below) * (ordered[above] - ordered[below])
