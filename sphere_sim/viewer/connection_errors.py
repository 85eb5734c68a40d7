# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Errors of connections as occasional messages of one line, instead of tracebacks."""

import asyncio
import errno
import logging
import sys
from typing import Any

from sphere_nmpc.fault_log import FaultLog

_PERIOD = 60.0
"""Least time between two messages about the same error [s]."""


class ConnectionErrors(logging.Handler):
    """Errors from the logger and the event loop of a server.

    Clients may send anything, at any rate, so the number of messages is limited.
    """

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self._log = FaultLog(self._write, _PERIOD)

    def emit(self, record: logging.LogRecord) -> None:
        """Report a log record, except failed handshakes, which any client can cause."""
        text = record.getMessage()
        if text != "opening handshake failed":
            self._report(text, record.exc_info[1] if record.exc_info else None)

    def handle_loop_error(
        self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]
    ) -> None:
        """Report an exception that nothing caught in the event loop."""
        self._report(str(context["message"]), context.get("exception"))

    def _report(self, text: str, error: BaseException | None) -> None:
        if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
            self._log.report(
                "a page has to wait", "too many open files; close pages or raise 'ulimit -n'"
            )
            return
        if error is not None:
            text += f", {type(error).__name__}: {error}"
        self._log.report("invalid input of a page was ignored", " ".join(text.split())[:200])

    @staticmethod
    def _write(line: str) -> None:
        print(f"viewer: {line}", file=sys.stderr, flush=True)
