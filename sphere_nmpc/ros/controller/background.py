# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Work that the control loop does not wait for."""

import queue
import threading
from collections.abc import Callable

_SOON = 2
"""Tasks that may wait; while one takes that long, newer ones are left out."""


class Background:
    """Does one task after another in a thread of its own.

    Parameters
    ----------
    on_error : callable
        Told of a task that failed, in one line.
    """

    def __init__(self, on_error: Callable[[str], object]) -> None:
        self._on_error = on_error
        self._tasks: queue.Queue[Callable[[], None] | None] = queue.Queue(_SOON)
        self._thread = threading.Thread(target=self._work, name="background", daemon=True)
        self._thread.start()

    def do(self, task: Callable[[], None]) -> bool:
        """Have a task done soon; False if too much is waiting and it will not be done."""
        try:
            self._tasks.put_nowait(task)
        except queue.Full:
            return False
        return True

    def close(self) -> None:
        """Finish what was begun and end the thread."""
        self._tasks.put(None)
        self._thread.join()

    def _work(self) -> None:
        while (task := self._tasks.get()) is not None:
            try:
                task()
            except Exception as error:
                # Whatever went wrong in there must not end all learning.
                self._on_error(f"{type(error).__name__}: {error}")
