# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Program of a worker process: makes calls for the parent until the parent ends."""

import contextlib
import logging
import os
import select
import threading
from collections.abc import Sequence

from sphere_nmpc.library_threads import limit_library_threads
from sphere_nmpc.worker.channel import Channel, encoded


def main(argv: Sequence[str]) -> int:
    """Receive ``(call, arguments)`` and send ``(result, error message)``, again and again.

    The only argument is the file descriptor of the channel.
    """
    link = Channel.inherited(int(argv[0]))
    limit_library_threads()
    # Warnings come once, from the parent.
    logging.getLogger("sphere_nmpc").setLevel(logging.ERROR)
    with contextlib.suppress(RuntimeError):  # no further thread: it ends after its present call
        threading.Thread(target=_end_with_parent, args=(link,), daemon=True).start()
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            link.send(_answer(link))
    return 0


def _answer(link: Channel) -> bytes:
    try:
        # Receiving imports the modules that the call needs, which may fail.
        call, arguments = link.receive()
        return encoded((call(*arguments), None))
    except (EOFError, ConnectionError):
        raise
    except Exception as error:
        return encoded((None, f"{type(error).__name__}: {error}"))


def _end_with_parent(link: Channel) -> None:
    """End the process during a call, too, when the other end of its channel is closed."""
    closed = select.poll()
    closed.register(link, 0)  # the end of the other side is always told
    closed.poll()
    os._exit(1)
