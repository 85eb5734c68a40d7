# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Log of faults in printable lines, with a limited rate for each kind of fault."""

import time
from collections import Counter
from collections.abc import Callable, Mapping

from sphere_nmpc.errors import printable_line

_PERIOD = 5.0
"""Shortest wall time between two lines about one kind of fault; one that comes and goes counts as
over after as long without it [s]."""

EVENTS_EVERY = 2.0
"""Period of a log of events that are no faults [s, wall]: goals, arrivals, pushes."""


class FaultLog:
    """Log each kind of fault when it first occurs, then at most once every `period` seconds.

    `write` takes a line, as ``node.get_logger().warning`` does.
    """

    def __init__(
        self,
        write: Callable[[str], object],
        period: float = _PERIOD,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._write = write
        self._period = period
        self.now = clock
        """Steady clock [s]."""
        self._logged_at: dict[str, float] = {}
        self._suppressed: Counter[str] = Counter()
        self._newest: dict[str, str] = {}
        self.counts: Counter[str] = Counter()
        """How often each kind of fault has occurred."""
        self._seen: Counter[str] = Counter()

    def report(self, kind: str, message: str) -> None:
        """Count a fault and log it, unless one of its kind was logged less than `period` ago.

        `kind` says what is wrong, in a few words that do not change, `message` what was given and
        what was expected.
        """
        self.counts[kind] += 1
        now = self.now()
        if not self._is_due(kind, now):
            self._suppressed[kind] += 1
            self._newest[kind] = message
            return
        self._log(kind, message, now)

    def has_risen(self, kind: str, count: int) -> bool:
        """Return whether the number of faults of a kind so far has risen since the last call."""
        before, self._seen[kind] = self._seen[kind], count
        return count > before

    def flush(self) -> None:
        """Log the newest suppressed fault of each kind whose `period` is over."""
        now = self.now()
        for kind in [kind for kind in self._suppressed if self._is_due(kind, now)]:
            self._suppressed[kind] -= 1  # the newest one is logged now
            self._log(kind, self._newest[kind], now)

    def _is_due(self, kind: str, now: float) -> bool:
        return kind not in self._logged_at or now - self._logged_at[kind] >= self._period

    def _log(self, kind: str, message: str, now: float) -> None:
        repeated = self._suppressed.pop(kind, 0)
        again = f" ({repeated} more since the last message)" if repeated else ""
        self._logged_at[kind] = now
        self._write(f"{printable_line(f'{kind}: {message}')}{again}")


class LastingFaults:
    """Log of the beginning of faults that last, to a `FaultLog`, and of their end."""

    def __init__(self, log: FaultLog, write_over: Callable[[str], object]) -> None:
        self._log = log
        self._write_over = write_over
        self._seen_at: dict[str, float] = {}

    def update(self, found: Mapping[str, str]) -> None:
        """Take the messages of the present faults by their kind; call it at intervals."""
        now = self._log.now()
        for kind, message in found.items():
            if kind not in self._seen_at:
                self._log.report(kind, message)
            self._seen_at[kind] = now
        for kind in [kind for kind, seen in self._seen_at.items() if now - seen > _PERIOD]:
            del self._seen_at[kind]
            self._write_over(f"{kind}: over")
