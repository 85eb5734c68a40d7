# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What simulated sensors have in common: sampling instants, and delivery after a latency."""

from collections import deque
from typing import Generic, TypeVar

from sphere_nmpc.quantities import NANOSECONDS

R = TypeVar("R")


class SampledSensor(Generic[R]):
    """Sensor that takes a reading at the multiples of a period and delivers it after a latency.

    Times are simulated time [ns]; rate and latency are given in Hz and s.
    """

    def __init__(self, rate: float, latency: float) -> None:
        self.period = round(NANOSECONDS / rate)
        self.latency = round(latency * NANOSECONDS)
        self.is_on = True
        """Whether it takes readings."""
        self._pending: deque[tuple[int, R]] = deque()

    def next_instant(self, now: int) -> int:
        """Return the first sampling instant after `now`."""
        return (now // self.period + 1) * self.period

    def is_due(self, now: int) -> bool:
        """Return whether it takes a reading at `now`."""
        return self.is_on and now % self.period == 0

    def deliver(self, now: int, reading: R) -> None:
        """Have a reading of the instant `now` delivered when the latency is over."""
        self._pending.append((now + self.latency, reading))

    def delivered(self, now: int) -> list[R]:
        """Return the readings that are due by now, each once, in order."""
        if not self._pending:
            return []
        found = [reading for due, reading in self._pending if due <= now]
        self._pending = deque(entry for entry in self._pending if entry[0] > now)
        return found
