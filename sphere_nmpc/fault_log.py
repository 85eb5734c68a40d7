# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults are told once, then now and then with a count, however often they happen."""

import time
from collections import Counter
from collections.abc import Callable


class FaultLog:
    """Log each kind of fault at once when it first happens, then at most every `period` seconds.

    Parameters
    ----------
    write : callable
        Takes a line, for example ``node.get_logger().warning``.
    period : float, optional
        Shortest wall time between two lines about one kind of fault [s].
    clock : callable, optional
        Steady clock [s].
    """

    def __init__(
        self,
        write: Callable[[str], object],
        period: float = 5.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._write = write
        self._period = period
        self._clock = clock
        self._told: dict[str, float] = {}
        self._untold: Counter[str] = Counter()
        self._newest: dict[str, str] = {}
        self.counts: Counter[str] = Counter()
        """How often each kind of fault has happened."""

    def report(self, kind: str, message: str) -> None:
        """Count a fault and log it, unless one of its kind was logged a moment ago.

        Parameters
        ----------
        kind : str
            What happened, in a few words that stay the same.
        message : str
            The thing, what was given and what was expected.
        """
        self.counts[kind] += 1
        now = self._clock()
        if kind in self._told and now - self._told[kind] < self._period:
            self._untold[kind] += 1
            self._newest[kind] = message
            return
        self._tell(kind, message, now)

    def catch_up(self) -> None:
        """Log the newest of each kind that was held back, once its time has come."""
        now = self._clock()
        for kind in [k for k in self._untold if now - self._told[k] >= self._period]:
            self._untold[kind] -= 1  # it is told itself
            self._tell(kind, self._newest[kind], now)

    def _tell(self, kind: str, message: str, now: float) -> None:
        repeated = self._untold.pop(kind, 0)
        again = f" ({repeated} more since last told)" if repeated else ""
        self._told[kind] = now
        self._write(f"{kind}: {message}{again}")
