# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Where runs are made: in this process, on its cores, or on a Dask cluster."""

import contextlib
import logging
import os
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Any

from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.errors import WorkersError
from sphere_sim.study.fingerprint import code_digest
from sphere_sim.study.processes import Processes
from sphere_sim.study.record import RunRecord
from sphere_sim.study.single_run import run_scenario

_CONNECT_TIMEOUT = 15.0
"""Patience with an existing scheduler [s]."""

_AHEAD = 4
"""Runs handed out for each thread of the cluster, so that none waits for work."""

Task = tuple[int, Scenario]


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Workers:
    """Make runs; a context manager, as processes have to be ended.

    Results do not depend on where they are made. Processes are started, or a cluster is joined,
    when the first run is asked for.

    Parameters
    ----------
    jobs : int
        Processes on this machine; 1 is this very process.
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
        self.close()

    def close(self) -> None:
        """End all processes, or leave the cluster."""
        self._client = None
        self._exits.close()

    def run(
        self, conditions: StudyConditions, tasks: Sequence[Task]
    ) -> Iterator[tuple[int, RunRecord]]:
        """Yield number and record of each run as it is made, in any order.

        Raises
        ------
        WorkersError
            If the scheduler cannot be reached, its workers run other code, or a worker dies over
            a run again and again.
        """
        if self._address is None:
            calls = ((index, (conditions, scenario)) for index, scenario in tasks)
            yield from self._processes.run(run_scenario, calls, "run")
        elif tasks:
            if self._client is None:
                self._client = self._exits.enter_context(_existing_cluster(self._address))
            yield from self._run_on(self._client, conditions, iter(tasks))

    def _run_on(
        self, client: Any, conditions: StudyConditions, tasks: Iterator[Task]
    ) -> Iterator[tuple[int, RunRecord]]:
        from distributed import as_completed

        numbers: dict[str, int] = {}

        def hand_out() -> Any:
            task = next(tasks, None)
            if task is None:
                return None
            future = client.submit(run_scenario, conditions, task[1], pure=False)
            numbers[future.key] = task[0]
            return future

        threads = sum(client.nthreads().values())
        first = [hand_out() for _ in range(max(1, _AHEAD * threads))]
        under_way = as_completed(
            [future for future in first if future is not None], loop=client.loop
        )
        for done in under_way:
            index = numbers.pop(done.key)
            if done.status != "finished":
                reason = done.exception() if done.status == "error" else "the scheduler is gone"
                raise WorkersError(f"run {index} could not be made: {reason}")
            record = done.result()
            following = hand_out()
            if following is not None:
                under_way.add(following)
            yield index, record


@contextlib.contextmanager
def _existing_cluster(address: str) -> Iterator[Any]:
    from distributed import Client

    for name in ("distributed", "distributed.client"):  # Dask sets the level of each
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error) or type(error).__name__
        raise WorkersError(f"scheduler {address}: cannot be reached ({reason})") from None
    with client:
        try:
            digests = client.run(code_digest)
        except Exception as error:  # whatever happens in a worker is raised here
            raise WorkersError(f"scheduler {address}: its workers fail ({error})") from None
        if not digests:
            raise WorkersError(f"scheduler {address}: has no workers")
        for worker, digest in digests.items():
            if not _same_code(digest):
                raise WorkersError(f"worker {worker}: runs another version of sphere_nmpc")
        yield client


def _same_code(digest: str) -> bool:
    return digest == code_digest()
