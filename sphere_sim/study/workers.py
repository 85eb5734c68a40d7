# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Workers of a study: this process, processes of this machine, or a Dask cluster."""

import asyncio
import contextlib
import logging
import os
import select
import signal
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from sphere_nmpc.errors import SphereNmpcError, printable_line, shown
from sphere_nmpc.process.channel import Channel, ChannelEndError, ContentError, encoded
from sphere_nmpc.process.child import Child, module_command, stop_together
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_nmpc.worker.serve import serve

TRIES = 3
"""Largest number of attempts at a call whose process ends during it."""
Task = tuple[Any, tuple[Any, ...]]
"""A name of the task, and the arguments of its call."""

_CONNECT_TIMEOUT = 15.0
"""How long to wait for the scheduler [s]."""
_TOLD_AFTER = 2.0
"""Wait for the scheduler after which the user is informed of it [s]."""
_AHEAD = 4
"""Tasks submitted for each thread of the cluster, so that none is idle."""

_log = logging.getLogger("sphere_nmpc")


class WorkersError(SphereNmpcError):
    """Processes or cluster cannot be started or reached, or a worker process ended."""


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _made(call: Callable[..., Any], arguments: tuple[Any, ...], _store: object) -> object:
    """Make a call; with its first two arguments this is a task of `serve`."""
    return call(*arguments)


class Workers(contextlib.ExitStack):
    """Make calls somewhere; a context manager, at whose end processes are ended.

    Results do not depend on where a call is made. Processes are started, or a cluster is joined,
    when they are needed. Processes ignore the signals of a terminal, such as Ctrl-C, which the
    parent handles, and end when the parent does, however that happens. A call whose process ends
    during it is made again in another one.

    The pool of `concurrent.futures` is not used: its processes outlive a parent that is killed,
    and when one of them ends unexpectedly it does not report during which call, and cancels all.

    With one of `jobs` the calls are made in this process. `scheduler` is the address of a Dask
    scheduler to use instead.
    """

    def __init__(self, jobs: int = 1, scheduler: str | None = None) -> None:
        super().__init__()
        self._jobs = jobs
        self._address = scheduler
        self._children: dict[Channel, Child] = {}
        self._client: Any = None
        self.callback(self._end)

    def run(
        self, call: Callable[..., Any], tasks: Sequence[Task], what: str
    ) -> Iterator[tuple[Any, Any]]:
        """Yield name and result of each task as it is done, in any order.

        The call is a function of a module; `what` is what a task is called in errors. That of a
        call in this process is raised as it is, any other one as `WorkersError`.
        """
        if self._address is not None and tasks:
            if self._client is None:
                self._client = self.enter_context(_joined_cluster(self._address))
            yield from _run_on_cluster(self._client, call, tasks, what)
        elif min(self._jobs, len(tasks)) <= 1:
            for name, arguments in tasks:
                yield name, call(*arguments)
        else:
            yield from self._run_in_processes(call, tasks, what)

    def _run_in_processes(
        self, call: Callable[..., Any], tasks: Sequence[Task], what: str
    ) -> Iterator[tuple[Any, Any]]:
        waiting = deque(tasks)
        deaths: Counter[Any] = Counter()
        busy: dict[Channel, Task] = {}

        def hand_out(channel: Channel) -> None:
            busy[channel] = waiting.popleft()
            # If the process has ended, reading its answer fails.
            with contextlib.suppress(ChannelEndError):
                channel.send(encoded(partial(_made, call, busy[channel][1])))

        while waiting or busy:
            while waiting and len(busy) < self._jobs:
                idle = next((each for each in self._children if each not in busy), None)
                try:
                    hand_out(idle or self._start())
                except WorkersError:
                    if not self._children:
                        raise
                    self._jobs = len(self._children)  # go on with those that there are
            ready, _, _ = select.select(list(busy), [], [])
            for channel in [each for each in busy if each in ready]:
                task = name, _ = busy.pop(channel)
                try:
                    result, failure = channel.receive()
                except ContentError as error:
                    raise WorkersError(f"{what} {name} cannot be read: {error}") from None
                except ChannelEndError:
                    deaths[name] += 1
                    dead = self._children.pop(channel)
                    dead.kill()
                    if deaths[name] == TRIES:
                        raise WorkersError(
                            f"{what} {name}: its process died {TRIES} times ({dead.ending}); is "
                            "there enough memory? The same command continues from what was made"
                        ) from None
                    waiting.appendleft(task)
                    continue
                if failure:
                    raise WorkersError(f"{what} {name} could not be made: {failure}")
                if waiting:
                    hand_out(channel)
                yield name, result

    def _start(self) -> Channel:
        """Return the channel to a new process."""
        try:
            child = Child(module_command(__name__), with_channel=True).start()
        except OSError as error:
            raise WorkersError(
                f"process {len(self._children) + 1} of {self._jobs} cannot be started "
                f"({error.strerror}); give fewer --jobs, of which 1 needs none"
            ) from None
        self._children[child.channel] = child
        return child.channel

    def _end(self) -> None:
        stop_together(list(self._children.values()), 0.0)
        self._children.clear()


def _run_on_cluster(
    client: Any, call: Callable[..., Any], tasks: Sequence[Task], what: str
) -> Iterator[tuple[Any, Any]]:
    """Yield name and result of each task on a joined cluster; otherwise as `Workers.run`."""
    from distributed import as_completed

    waiting = iter(tasks)
    names: dict[Any, Any] = {}

    def submit_next() -> Any:
        task = next(waiting, None)
        if task is None:
            return None
        future = client.submit(call, *task[1], pure=False)
        names[future.key] = task[0]
        return future

    threads = sum(client.nthreads().values())
    first = [submit_next() for _ in range(max(1, _AHEAD * threads))]
    pending = as_completed([future for future in first if future is not None], loop=client.loop)
    for done in pending:
        name = names.pop(done.key)
        if done.status != "finished":
            reason = done.exception() if done.status == "error" else "the scheduler is gone"
            raise WorkersError(f"{what} {name} could not be made: {reason}")
        result = done.result()
        following = submit_next()
        if following is not None:
            pending.add(following)
        yield name, result


@contextlib.contextmanager
def _joined_cluster(address: str) -> Iterator[Any]:
    """Connect to a scheduler whose workers run the same code as this process."""
    # Only here: Dask takes a second to load, and a worker process must not load NumPy yet.
    from distributed import Client

    from sphere_sim.study.journal import code_digest

    for name in ("distributed", "distributed.client"):  # Dask sets the level of each
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        # A client that fails to connect takes half a minute more, and then shows a traceback.
        asyncio.run(asyncio.wait_for(_find_scheduler(address), _CONNECT_TIMEOUT))
        client = Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except Exception as error:  # the answer of another program can cause any, also MemoryError
        late = f"no answer within {_CONNECT_TIMEOUT:g} s"
        text = late if isinstance(error, asyncio.TimeoutError) else str(error)
        reason = printable_line(text or type(error).__name__)
        raise WorkersError(f"scheduler {address}: cannot be reached ({reason})") from None
    with client:
        try:
            digests = client.run(code_digest)
        except Exception as error:  # any error of a worker is raised here
            raise WorkersError(f"scheduler {address}: its workers fail ({error})") from None
        if not digests:
            raise WorkersError(f"scheduler {address}: has no workers")
        for worker, digest in digests.items():
            if digest != code_digest():
                raise WorkersError(f"worker {worker}: runs another version of sphere_nmpc")
        yield client


async def _find_scheduler(address: str) -> None:
    """Raise unless a Dask scheduler answers at an address."""
    from distributed import Security
    from distributed.comm import connect

    notice = asyncio.get_running_loop().call_later(
        _TOLD_AFTER, _log.warning,
        "sphere_nmpc study: waiting for the scheduler %s, at most %g s", address, _CONNECT_TIMEOUT,
    )
    try:
        security = Security().get_connection_args("client")
        comm = await connect(address, timeout=_CONNECT_TIMEOUT, **security)
        try:
            await comm.write({"op": "identity", "reply": True})
            found = (await comm.read())["type"]
        finally:
            comm.abort()
    finally:
        notice.cancel()
    if found != "Scheduler":
        raise ValueError(f"given Dask's {shown(found)}, expected a scheduler")


def main(argv: Sequence[str]) -> int:
    """Make the calls of the parent, given the descriptor of the channel, until it is closed."""
    # Nobody interrupts it but its parent, by a signal that ends it at once.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_library_threads()
    # Warnings come once, from the parent.
    _log.setLevel(logging.ERROR)
    serve(Channel.inherited(int(argv[0])))
    return 0
