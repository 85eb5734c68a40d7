# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Worker in a process of its own, so that its work never holds the interpreter of the loop."""

import os
import signal
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sphere_nmpc.process.channel import Channel, ChannelEndError, ContentError, encoded
from sphere_nmpc.process.child import Child, module_command
from sphere_nmpc.worker.contract import Reply, Result, Task

_MAX_PENDING = 8
"""Tasks that may be pending."""
_MAX_PENDING_BYTES = 150_000
"""Bytes of these tasks: what a socket of Linux takes in any case, so that sending never blocks; a
transition has some 60 000 at 1 kHz."""
_RESULT_TIMEOUT = 3.0
"""Time without a result after which a worker that has a task is replaced [s]: a search takes a
tenth of it at most. Processor time where it waits for processor or disk, otherwise wall time."""
_FIRST_RESULT_TIMEOUT = 20.0
"""Time without its first result after which a worker is replaced [s]: it has to be loaded."""
_RESTART_EVERY = 1.0
"""Shortest wall time between two starts of the process [s]."""


class WorkerProcess:
    """`Worker` whose tasks are done by a child process.

    A process that ends, or that is silent for too long, is replaced; its tasks then fail, and
    whatever they kept in its store is lost. `on_fault` is called with one line about each failed
    task and each replaced process.
    """

    def __init__(self, on_fault: Callable[[str], object]) -> None:
        self._on_fault = on_fault
        self._pending: deque[tuple[Reply[Any], int]] = deque()
        """Replies that are awaited, and the sizes of their tasks [bytes]."""
        self._child: Child | None = None
        self._used: float | None = None
        self._patience: float
        self._start()

    @property
    def available(self) -> bool:
        """Whether there is a process; after its end there is none for a second."""
        self._restart()
        return self._child is not None

    @property
    def pid(self) -> int:
        """Id of the present process; 0 while there is none."""
        return 0 if self._child is None else self._child.pid

    def submit(self, task: Task[Result]) -> Reply[Result]:
        """Send a task to the process; see `Worker.submit`."""
        reply: Reply[Result] = Reply()
        try:
            message = encoded(task)
        except Exception as error:
            # Whatever cannot be sent must not reach the control loop.
            reply.error = f"given a task that cannot be sent: {type(error).__name__}: {error}"
            self._on_fault(reply.error)
            return reply
        self._restart()
        child = self._child
        size, sizes = len(message.content), [one for _, one in self._pending]
        full = len(sizes) >= _MAX_PENDING or sum(sizes) + size > _MAX_PENDING_BYTES
        if child is None or full:
            reply.error = "the worker has ended" if child is None else "the worker is busy"
            return reply
        if not self._pending:
            self._heard = time.monotonic()
        try:
            child.channel.send(message)
        except ChannelEndError as error:
            self._replace(str(error))
            reply.error = "the worker has ended"
            return reply
        self._pending.append((reply, size))
        return reply

    def poll(self) -> None:
        """Take the results that have arrived, and replace a process that does not answer."""
        child = self._child
        if child is None or not self._pending:
            return
        # Before the results are taken: it may have finished since.
        silent, awaited = time.monotonic() - self._heard, self._pending[0][0]
        stuck = silent > self._patience and not self._waits()
        try:
            while self._pending:
                result, error = _answer(child.channel)
                self._heard, self._patience = time.monotonic(), _RESULT_TIMEOUT
                self._used = None
                reply, _ = self._pending.popleft()
                reply.result, reply.error, reply.ready = result, error, not error
                if error:
                    self._on_fault(error)
        except BlockingIOError:
            pass  # What is left has not arrived as a whole.
        except ChannelEndError as error:
            self._replace(str(error))
            return
        if stuck and awaited.pending:
            self._replace(f"given no result for {silent:.1f} s, expected {self._patience:g} s")

    def close(self) -> None:
        """End the process for good; pending tasks fail."""
        self._started = float("inf")
        self._fail("the worker is closed")
        if self._child is not None:
            self._child.kill()  # it keeps nothing
            self._child = None

    def _start(self) -> None:
        """Start a process; it ends when the other end of its channel is closed."""
        self._started = self._heard = time.monotonic()
        self._patience = _FIRST_RESULT_TIMEOUT
        self._used = None
        try:
            command = module_command("sphere_nmpc.worker.serve")
            self._child = Child(command, with_channel=True).start()
            self._child.channel.never_wait()
        except OSError as error:
            self._on_fault(f"worker not started: {error}")

    def _waits(self) -> bool:
        """Return whether the process would work but for other processes, on Linux.

        It waits for a processor or the disk, and has had little processor time since this was
        asked first. On a busy machine another process would only have to be loaded as well.
        """
        try:
            fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return False
        used = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        self._used = used if self._used is None else self._used
        return fields[0] in "RD" and used - self._used < self._patience

    def _replace(self, why: str) -> None:
        """Start another process unless one was started just now; `submit` does it later then."""
        self._on_fault(f"worker replaced: {why}")
        self._fail(why)
        if self._child is not None:
            # Without waiting for its end, which takes some milliseconds.
            self._child.channel.close()
            self._child.send(signal.SIGKILL)
            self._child = None
        self._restart()

    def _restart(self) -> None:
        """Start a process where there is none, and none was started just now."""
        if self._child is None and time.monotonic() - self._started > _RESTART_EVERY:
            self._start()

    def _fail(self, why: str) -> None:
        while self._pending:
            self._pending.popleft()[0].error = why


def _answer(channel: Channel) -> tuple[Any, str]:
    """Return the next result and its error, empty if there is none."""
    try:
        result, error = channel.receive()
    except ContentError as unreadable:
        return None, f"given a result that cannot be read: {unreadable}"
    return result, error
