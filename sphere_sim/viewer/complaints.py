# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What goes wrong with connections, as one line now and then instead of tracebacks."""

import asyncio
import errno
import logging
import sys
from typing import Any

from sphere_nmpc.fault_log import FaultLog

_PERIOD = 60.0
"""Least time between two lines about the same [s]."""


class Complaints(logging.Handler):
    """Takes the faults of a server from its logger and its event loop.

    Whoever connects may send anything, and as often as they like.
    """

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self._log = FaultLog(self._write, _PERIOD)

    def emit(self, record: logging.LogRecord) -> None:
        """Tell of a record, unless it is of somebody who never came in."""
        what = record.getMessage()
        if what != "opening handshake failed":
            self._tell(what, record.exc_info[1] if record.exc_info else None)

    def take(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Tell of what nobody caught in the event loop."""
        self._tell(str(context["message"]), context.get("exception"))

    def _tell(self, what: str, error: BaseException | None) -> None:
        if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
            self._log.report(
                "a page has to wait", "too many open files; close pages or raise 'ulimit -n'"
            )
            return
        if error is not None:
            what += f", {type(error).__name__}: {error}"
        self._log.report("what a page sent was left out", " ".join(what.split())[:200])

    @staticmethod
    def _write(line: str) -> None:
        print(f"viewer: {line}", file=sys.stderr, flush=True)
