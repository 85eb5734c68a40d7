# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Calls made by the workers of an existing Dask cluster."""

import contextlib
import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from distributed import Client, as_completed

from sphere_sim.study.errors import WorkersError
from sphere_sim.study.fingerprint import worker_code_digest
from sphere_sim.study.processes import Task

_CONNECT_TIMEOUT = 15.0
"""How long to wait for the scheduler [s]."""

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
        If it cannot be reached, has no workers, or these fail or run other code.
    """
    for name in ("distributed", "distributed.client"):  # Dask sets the level of each
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error) or type(error).__name__
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


def _same_code(digest: str) -> bool:
    return digest == worker_code_digest()
