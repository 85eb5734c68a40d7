# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Pool of processes on this machine, none of which outlives its parent.

The pool of `concurrent.futures` is not used: its processes outlive a parent that is killed, and
when one of them ends unexpectedly it does not report during which call, and cancels all calls.
"""

import contextlib
import logging
import select
import signal
import subprocess
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from types import TracebackType
from typing import Any

from sphere_nmpc.child_command import module_command
from sphere_nmpc.end_signals import END_SIGNALS, TERMINAL_SIGNALS
from sphere_nmpc.worker.channel import Channel, encoded
from sphere_sim.study.errors import WorkersError

TRIES = 3
"""Largest number of attempts at a call whose process ends during it."""

_log = logging.getLogger("sphere_nmpc")

Task = tuple[Any, tuple[Any, ...]]
"""A name of the task, and the arguments of its call."""


class Processes:
    """Make calls in processes; a context manager, at whose end all of them are killed.

    Processes are started when they are needed. They ignore the signals of a terminal, such as
    Ctrl-C, which the parent handles, and end when the parent does, however that happens. A call
    whose process ends during it is made again in another one.

    Parameters
    ----------
    jobs : int
        Number of processes; with 1 the calls are made in this process.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._processes: dict[Channel, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> "Processes":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for process in self._processes.values():
            process.kill()
        for link in list(self._processes):
            self._remove(link)

    def run(
        self, call: Callable[..., Any], tasks: Iterable[Task], what: str
    ) -> Iterator[tuple[Any, Any]]:
        """Yield name and result of each task as it is done, in any order.

        Parameters
        ----------
        call : callable
            A function of a module.
        tasks : iterable of (object, tuple)
            A name and arguments for each call.
        what : str
            What a task is called in errors.

        Raises
        ------
        WorkersError
            If no process can be started, a call raises, or its process ends in `TRIES` attempts.
        """
        waiting = deque(tasks)
        if min(self._jobs, len(waiting)) <= 1:
            for name, arguments in waiting:
                yield name, call(*arguments)
            return
        deaths: Counter[Any] = Counter()
        busy: dict[Channel, Task] = {}

        def hand_out(link: Channel) -> None:
            busy[link] = waiting.popleft()
            # If the process has ended, reading its answer fails.
            with contextlib.suppress(OSError):
                link.send(encoded((call, busy[link][1])))

        while waiting or busy:
            while waiting and len(busy) < self._jobs:
                idle = next((link for link in self._processes if link not in busy), None)
                link = idle or self._start()
                if link is not None:
                    hand_out(link)
            ready, _, _ = select.select(list(busy), [], [])
            for link in [each for each in busy if each in ready]:
                task = name, _ = busy.pop(link)
                try:
                    result, failure = link.receive()
                except (EOFError, OSError):
                    deaths[name] += 1
                    reason = self._remove(link)
                    if deaths[name] == TRIES:
                        raise WorkersError(
                            f"{what} {name}: its process died {TRIES} times ({reason}); is there "
                            "enough memory? The same command continues from what was made"
                        ) from None
                    waiting.appendleft(task)
                    continue
                if failure is not None:
                    raise WorkersError(f"{what} {name} could not be made: {failure}")
                if waiting:
                    hand_out(link)
                yield name, result

    def _start(self) -> Channel | None:
        """Return the connection to a new process; None where the system allows no further one.

        The number of processes is then reduced to those that run.
        """
        try:
            with _interrupts_deferred():
                here, there = Channel.pair()
                with contextlib.closing(there), contextlib.ExitStack() as unless_started:
                    unless_started.callback(here.close)
                    self._processes[here] = subprocess.Popen(
                        module_command("sphere_sim.study.worker_process", str(there.fileno())),
                        stdin=subprocess.DEVNULL, pass_fds=[there.fileno()],
                    )
                    unless_started.pop_all()
        except OSError as error:
            if not self._processes:
                raise WorkersError(
                    f"no process can be started ({error.strerror}); --jobs 1 needs none"
                ) from None
            _log.warning(
                "sphere_nmpc study: %d of %d processes can be started (%s) and do all the work",
                len(self._processes), self._jobs, error.strerror,
            )
            self._jobs = len(self._processes)
            return None
        return here

    def _remove(self, link: Channel) -> str:
        """Remove a process that has ended and return how it ended."""
        process = self._processes.pop(link)
        link.close()
        code = process.wait()
        return f"signal {-code}" if code < 0 else f"exit code {code}"


@contextlib.contextmanager
def _interrupts_deferred() -> Iterator[None]:
    """Block the signals of a terminal for processes that are started, and defer them for this one.

    A new process inherits which signals are blocked. For this process blocking is not enough:
    another thread may take the signal and have it handled in the main thread, in the middle of the
    start.
    """
    received: list[int] = []
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL_SIGNALS)
    handlers = {}
    if threading.current_thread() is threading.main_thread():
        for number in END_SIGNALS:
            handlers[number] = signal.signal(number, lambda number, _: received.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for caught in received:
            signal.raise_signal(caught)
