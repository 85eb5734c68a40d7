# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Calls spread over processes of this machine, none of which outlives its parent.

The pool of `concurrent.futures` does not serve: its processes outlive a parent that is killed, and
when one of them dies it does not tell over which call, and gives up all of them.
"""

import contextlib
import logging
import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from multiprocessing import connection, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any

from sphere_nmpc.library_threads import limit_library_threads
from sphere_sim.study.errors import WorkersError

TRIES = 3
"""How often a call is made anew whose process died over it."""


_log = logging.getLogger("sphere_nmpc")

Task = tuple[Any, tuple[Any, ...]]
"""A name of the task, and the arguments of its call."""


class Processes:
    """Make calls in processes; a context manager, at whose end all of them are killed.

    Processes are started when they are needed. They do not hear Ctrl-C, which is for their parent
    to answer, and end when the parent does, however that happens. A call whose process dies is
    made again in another one.

    Parameters
    ----------
    jobs : int
        How many; with 1 the calls are made in this very process.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        # Fresh interpreters: a fork would copy the threads of whoever calls.
        self._context = multiprocessing.get_context("spawn")
        self._processes: dict[Connection, BaseProcess] = {}

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
            self._bury(link)

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
            If no process can be started, a call raises, or its process dies again and again.
        """
        waiting = deque(tasks)
        if min(self._jobs, len(waiting)) <= 1:
            for name, arguments in waiting:
                yield name, call(*arguments)
            return
        deaths: Counter[Any] = Counter()
        busy: dict[Connection, Task] = {}

        def hand_out(link: Connection) -> None:
            busy[link] = waiting.popleft()
            # A dead process is met when its answer is waited for.
            with contextlib.suppress(OSError):
                link.send((call, busy[link][1]))

        while waiting or busy:
            while waiting and len(busy) < self._jobs:
                idle = next((link for link in self._processes if link not in busy), None)
                link = idle or self._start()
                if link is not None:
                    hand_out(link)
            for ready in connection.wait(list(busy)):
                assert isinstance(ready, Connection)
                task = name, _ = busy.pop(ready)
                try:
                    result, trouble = ready.recv()
                except (EOFError, OSError):
                    deaths[name] += 1
                    reason = self._bury(ready)
                    if deaths[name] == TRIES:
                        raise WorkersError(
                            f"{what} {name}: its process died {TRIES} times ({reason}); is there "
                            "enough memory? The same command goes on from what was made"
                        ) from None
                    waiting.appendleft(task)
                    continue
                if trouble is not None:
                    raise WorkersError(f"{what} {name} could not be made: {trouble}")
                if waiting:
                    hand_out(ready)
                yield name, result

    def _start(self) -> Connection | None:
        """Start a process; None, and fewer from now on, where no further one can be had."""
        try:
            resource_tracker.ensure_running()  # which would undo the blocking below
            with _interrupts_later():
                ours, theirs = self._context.Pipe()
                process = self._context.Process(target=_serve, args=(theirs,), daemon=True)
                with theirs:
                    process.start()
                self._processes[ours] = process
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
        return ours

    def _bury(self, link: Connection) -> str:
        """Forget a process that has died, and return how."""
        process = self._processes.pop(link)
        link.close()
        process.join()
        code = process.exitcode or 0
        process.close()
        return f"signal {-code}" if code < 0 else f"exit code {code}"


@contextlib.contextmanager
def _interrupts_later() -> Iterator[None]:
    """Let processes started meanwhile never hear Ctrl-C; this one hears it afterwards.

    A process that is started inherits which signals are blocked. For this process that is not
    enough, as another thread may take the signal and have it handled in the main one, which would
    leave half a process.
    """
    heard: list[int] = []
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    handlers = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            handlers[number] = signal.signal(number, lambda number, _: heard.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for caught in heard:
            signal.raise_signal(caught)


def _serve(link: Connection) -> None:
    """Answer calls until the parent is gone."""
    limit_library_threads()
    # What there is to tell the parent has told.
    logging.getLogger("sphere_nmpc").setLevel(logging.ERROR)
    with contextlib.suppress(RuntimeError):  # no thread to be had: it ends after its call
        threading.Thread(target=_end_with_parent, daemon=True).start()
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            link.send(_answer(link))


def _answer(link: Connection) -> tuple[Any, str | None]:
    try:
        # What the call needs is imported here.
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
