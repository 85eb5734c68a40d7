# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Main function of a worker process: make calls for the parent until the parent ends."""

import contextlib
import logging
import multiprocessing
import os
import threading
from multiprocessing import connection
from multiprocessing.connection import Connection
from typing import Any

from sphere_nmpc.library_threads import limit_library_threads


def serve(link: Connection) -> None:
    """Receive ``(call, arguments)`` and send ``(result, error message)``, again and again."""
    limit_library_threads()
    # Warnings come once, from the parent.
    logging.getLogger("sphere_nmpc").setLevel(logging.ERROR)
    with contextlib.suppress(RuntimeError):  # no further thread: it ends after its present call
        threading.Thread(target=_end_with_parent, daemon=True).start()
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            link.send(_answer(link))


def _answer(link: Connection) -> tuple[Any, str | None]:
    try:
        # Receiving imports the modules that the call needs, which may fail.
        call, arguments = link.recv()
        return call(*arguments), None
    except (EOFError, ConnectionError):
        raise
    except Exception as error:
        return None, f"{type(error).__name__}: {error}"


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
