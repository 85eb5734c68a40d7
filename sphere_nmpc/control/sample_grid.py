# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Sample instants behind the moments at which a timer really fires."""


import math

_EARLY = 0.25
"""How much earlier than its instant a tick may seem, in periods: the first one may have been late.

Later ones are late by up to the rest of a period before they count for the next instant.
"""


class SampleGrid:
    """Instants t_0 + k T of which a timer shows a late picture; times are control times [s].

    The earliest phase seen counts: a timer fires late by chance, but never early.

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
        """Forget the phase, as after a jump of the clock, and take another period if given."""
        self._period = self._period if period is None else period
        self._origin: float | None = None
        self._last = 0

    def instant(self, now: float) -> float:
        """Return the sample instant that a tick at `now` stands for, and count those missed."""
        if self._origin is None:
            self._origin = now
            return now
        k = math.floor((now - self._origin) / self._period + _EARLY)
        if self._origin + k * self._period > now:
            self._origin = now - k * self._period
        self.missed += max(0, k - self._last - 1)
        self._last = k
        return self._origin + k * self._period
