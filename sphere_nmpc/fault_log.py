# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Log of faults in printable lines, with a limited rate for each kind of fault."""

import time
from collections import Counter
from collections.abc import Callable

from sphere_nmpc.foreign_text import printable_line


class FaultLog:
    """Log each kind of fault when it first occurs, then at most once every `period` seconds.

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
        self._logged_at: dict[str, float] = {}
        self._suppressed: Counter[str] = Counter()
        self._newest: dict[str, str] = {}
        self.counts: Counter[str] = Counter()
        """How often each kind of fault has occurred."""

    def report(self, kind: str, message: str) -> None:
        """Count a fault and log it, unless one of its kind was logged less than `period` ago.

        Parameters
        ----------
        kind : str
            What is wrong, in a few words that do not change.
        message : str
            What was given and what was expected.
        """
        self.counts[kind] += 1
        now = self._clock()
        if kind in self._logged_at and now - self._logged_at[kind] < self._period:
            self._suppressed[kind] += 1
            self._newest[kind] = message
            return
        self._log(kind, message, now)

    def flush(self) -> None:
        """Log the newest suppressed fault of each kind whose `period` is over."""
        now = self._clock()
        for kind in [k for k in self._suppressed if now - self._logged_at[k] >= self._period]:
            self._suppressed[kind] -= 1  # the newest one is logged now
            self._log(kind, self._newest[kind], now)

    def _log(self, kind: str, message: str, now: float) -> None:
        repeated = self._suppressed.pop(kind, 0)
        again = f" ({repeated} more since the last message)" if repeated else ""
        self._logged_at[kind] = now
        self._write(f"{printable_line(f'{kind}: {message}')}{again}")
