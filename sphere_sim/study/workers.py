# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Workers of a study: this process, processes of this machine, or a Dask cluster."""

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from types import TracebackType
from typing import Any

from sphere_sim.study.processes import Processes, Task


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Workers:
    """Make calls somewhere; a context manager, at whose end processes are ended.

    Results do not depend on where a call is made. Processes are started, or a cluster is joined,
    with the first call.

    Parameters
    ----------
    jobs : int
        Processes on this machine; with 1 the calls are made in this process.
    scheduler : str, optional
        Address of an existing Dask scheduler to use instead.
    """

    def __init__(self, jobs: int = 1, scheduler: str | None = None) -> None:
        self._address = scheduler
        self._exits = contextlib.ExitStack()
        self._processes = self._exits.enter_context(Processes(jobs))
        self._client: Any = None

    def __enter__(self) -> "Workers":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._client = None
        self._exits.close()

    def run(
        self, call: Callable[..., Any], tasks: Sequence[Task], what: str
    ) -> Iterator[tuple[Any, Any]]:
        """Yield name and result of each task as it is done, in any order.

        Parameters
        ----------
        call : callable
            A function of a module that `sphere_sim.study.fingerprint.WORKER_MODULES` names.
        tasks : sequence of (object, tuple)
            A name and arguments for each call.
        what : str
            What a task is called in errors.

        Raises
        ------
        WorkersError
            If processes cannot be started, the scheduler cannot be reached, its workers run other
            code, a call raises, or its worker process ends repeatedly.
        """
        if self._address is None:
            yield from self._processes.run(call, tasks, what)
        elif tasks:
            # Dask is loaded for clusters only: it takes a second.
            from sphere_sim.study.cluster import joined_cluster, run_on_cluster

            if self._client is None:
                self._client = self._exits.enter_context(joined_cluster(self._address))
            yield from run_on_cluster(self._client, call, tasks, what)
