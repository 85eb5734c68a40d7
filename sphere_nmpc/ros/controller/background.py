# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Background thread for work that the control loop does not wait for."""

import queue
import threading
from collections.abc import Callable

_QUEUE_LENGTH = 2
"""Tasks that may wait; further ones are dropped."""


class Background:
    """Thread that does one task after another.

    Parameters
    ----------
    on_error : callable
        Called with one line about each task that failed.
    """

    def __init__(self, on_error: Callable[[str], object]) -> None:
        self._on_error = on_error
        self._tasks: queue.Queue[Callable[[], None] | None] = queue.Queue(_QUEUE_LENGTH)
        self._thread = threading.Thread(target=self._work, name="background", daemon=True)
        self._thread.start()

    def do(self, task: Callable[[], None]) -> bool:
        """Queue a task; return False if the queue is full and the task is dropped."""
        try:
            self._tasks.put_nowait(task)
        except queue.Full:
            return False
        return True

    def close(self) -> None:
        """Complete the queued tasks and end the thread."""
        self._tasks.put(None)
        self._thread.join()

    def _work(self) -> None:
        while (task := self._tasks.get()) is not None:
            try:
                task()
            except Exception as error:
                # An error in one task must not prevent the next ones.
                self._on_error(f"{type(error).__name__}: {error}")
