# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Calls made by the workers of an existing Dask cluster."""

import asyncio
import contextlib
import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from distributed import Client, Security, as_completed
from distributed.comm import connect

from sphere_nmpc.foreign_text import printable_line, shown
from sphere_sim.study.errors import WorkersError
from sphere_sim.study.fingerprint import worker_code_digest
from sphere_sim.study.processes import Task

_CONNECT_TIMEOUT = 15.0
"""How long to wait for the scheduler [s]."""
_TOLD_AFTER = 2.0
"""Wait for the scheduler after which it is said [s]."""

_log = logging.getLogger("sphere_nmpc")

_AHEAD = 4
"""Tasks submitted for each thread of the cluster, so that none is idle."""


def run_on_cluster(
    client: Client, call: Callable[..., Any], tasks: Sequence[Task], what: str
) -> Iterator[tuple[Any, Any]]:
    """Yield name and result of each task as it is done, in any order.

    Parameters
    ----------
    client : distributed.Client
        As `joined_cluster` yields it.
    call, tasks, what
        As for `sphere_sim.study.workers.Workers.run`.

    Raises
    ------
    WorkersError
        If a call raises, its worker process ends repeatedly, or the scheduler ends.
    """
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
def joined_cluster(address: str) -> Iterator[Client]:
    """Connect to a scheduler whose workers run the same code as this process.

    Raises
    ------
    WorkersError
        If it cannot be reached, is none, has no workers, or these fail or run other code.
    """
    for name in ("distributed", "distributed.client"):  # Dask sets the level of each
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        # A client that fails to connect takes half a minute more, and then shows a traceback.
        asyncio.run(_find_scheduler(address))
        client = Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except Exception as error:  # the answer of another program can cause any, also MemoryError
        reason = printable_line(str(error) or type(error).__name__)
        raise WorkersError(f"scheduler {address}: cannot be reached ({reason})") from None
    with client:
        try:
            digests = client.run(worker_code_digest)
        except Exception as error:  # any error of a worker is raised here
            raise WorkersError(f"scheduler {address}: its workers fail ({error})") from None
        if not digests:
            raise WorkersError(f"scheduler {address}: has no workers")
        for worker, digest in digests.items():
            if not _same_code(digest):
                raise WorkersError(f"worker {worker}: runs another version of sphere_nmpc")
        yield client


async def _find_scheduler(address: str) -> None:
    """Raise unless a Dask scheduler answers at an address within `_CONNECT_TIMEOUT`."""
    async def ask() -> object:
        security = Security().get_connection_args("client")
        comm = await connect(address, timeout=_CONNECT_TIMEOUT, **security)
        try:
            await comm.write({"op": "identity", "reply": True})
            return (await comm.read())["type"]
        finally:
            comm.abort()

    asking = asyncio.ensure_future(ask())
    done, _ = await asyncio.wait({asking}, timeout=_TOLD_AFTER)
    if not done:
        _log.warning(
            "sphere_nmpc study: waiting for the scheduler %s, at most %g s", address,
            _CONNECT_TIMEOUT,
        )
    try:
        found = await asyncio.wait_for(asking, _CONNECT_TIMEOUT - _TOLD_AFTER)
    except asyncio.TimeoutError:
        raise OSError(f"no answer of a scheduler within {_CONNECT_TIMEOUT:g} s") from None
    if found != "Scheduler":
        raise ValueError(f"given Dask's {shown(found)}, expected a scheduler")


def _same_code(digest: str) -> bool:
    return digest == worker_code_digest()
