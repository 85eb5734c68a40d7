# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Sampling instants reconstructed from the times at which a timer fires late."""

import math

_EARLY = 0.25
"""How much before its instant a tick may appear to be, in periods: the first one may be late.

A tick may be late by up to the rest of a period before it counts for the next instant.
"""


class SampleGrid:
    """Instants t_0 + k T estimated from the ticks of a timer; times are control times [s].

    The earliest phase counts: a timer fires late by chance, but never early.

    Parameters
    ----------
    period : float
        T [s].
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self.missed = 0
        """Instants that passed without a tick."""
        self.reset()

    def reset(self, period: float | None = None) -> None:
        """Begin a new grid at the next tick, with another period [s] if given."""
        self._period = self._period if period is None else period
        self._origin: float | None = None
        self._last = 0

    def instant(self, now: float) -> float:
        """Return the sampling instant of a tick at `now` [s], and count those missed before it."""
        if self._origin is None:
            self._origin = now
            return now
        k = math.floor((now - self._origin) / self._period + _EARLY)
        if self._origin + k * self._period > now:
            self._origin = now - k * self._period
        self.missed += max(0, k - self._last - 1)
        self._last = k
        return self._origin + k * self._period
