# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A worker whose results arrive after a given time on any clock, so that tests repeat."""

from collections import deque
from collections.abc import Callable
from typing import Any

from sphere_nmpc.worker.contract import Reply, Result, Store, Task


class DelayedWorker:
    """`Worker` that does each task when it is submitted, and delivers the result after `delay`.

    `clock` returns the time; both are in seconds.
    """

    def __init__(self, clock: Callable[[], float], delay: float) -> None:
        self._clock = clock
        self.delay = delay
        self.available = True
        self.busy = False
        """Whether it refuses all tasks."""
        self.store: Store = {}
        self.tasks: list[Any] = []
        """All tasks taken so far."""
        self._waiting: deque[tuple[float, Reply[Any], Any]] = deque()

    def submit(self, task: Task[Result]) -> Reply[Result]:
        """Do a task, and keep its result."""
        reply: Reply[Result] = Reply()
        if self.busy:
            reply.error = "the worker is busy"
            return reply
        self.tasks.append(task)
        result, error = None, ""
        try:
            result = task(self.store)
        except Exception as raised:
            error = str(raised)
        self._waiting.append((self._clock() + self.delay, reply, (result, error)))
        return reply

    def lose(self) -> None:
        """End and start again, as a process that was killed: what the tasks kept is lost."""
        self.store.clear()
        for _, reply, _ in self._waiting:
            reply.error = "killed"
        self._waiting.clear()

    def poll(self) -> None:
        """Deliver the results that are due."""
        while self._waiting and self._waiting[0][0] <= self._clock():
            _, reply, (reply.result, reply.error) = self._waiting.popleft()
            reply.ready = not reply.error
