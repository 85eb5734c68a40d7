# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What a node stores on disk for its next run: the goals in force, or its last pose."""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Generic, TypeVar

from sphere_nmpc.foreign.own_folder import KeptFile, cache_folder
from sphere_nmpc.reporting.fault_log import FaultLog
from sphere_nmpc.ros.control_clock import ControlClock
from sphere_nmpc.ros.guarded_node import GuardedNode

T = TypeVar("T")
SAVE_EVERY = 1.0
"""Wall time after which the present value is stored again [s]."""


class Stored(Generic[T]):
    """Value that is stored again and again; that of the last run is restored once.

    It is written by a thread of its own, since a disk may take longer than a control period, to
    the file that `memory` returns, one for each domain and full name of a node; for `keep` = 0 [s]
    there is none. `what` names it, and `without` what a restart will do without it.
    """

    def __init__(
        self, node: GuardedNode, memory: Callable[[Path, float], KeptFile[T]], keep: float,
        clock: ControlClock, fault_log: FaultLog, what: str, without: str,
    ) -> None:
        name = node.get_fully_qualified_name().strip("/").replace("/", ".")
        file = f"{what}.{os.environ.get('ROS_DOMAIN_ID') or '0'}.{name}.json"
        self._memory = memory(cache_folder() / file, keep) if keep > 0.0 else None
        self._what, self._without = what, without
        self._clock = clock
        self._fault_log = fault_log
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="stored")
        # The thread that writes ends with the node.
        node.resources.callback(self.close)
        self._written: Future[None] | None = None
        self.is_settled = False
        """Whether what was stored has been restored, or is superseded as a new one was given."""

    def restore(self) -> tuple[T, float] | None:
        """Return what to continue with, and its age [s, wall].

        It is returned at most once, by the first call with a known time; otherwise None is.
        """
        if self.is_settled or self._clock.now() is None:
            return None
        self.is_settled = True
        if self._memory is None:
            return None
        try:
            return self._memory.recall(self._clock.stamp(), self._clock.simulated)
        except OSError as error:
            self._give_up(error)
            return None

    def save(self, value: T | None) -> None:
        """Begin to store a value, or that there is none."""
        self._report_failure()
        if self._memory is None or not self.is_settled or self._clock.now() is None:
            return
        self._written = self._writer.submit(
            self._memory.save, value, self._clock.stamp(), self._clock.simulated
        )

    def close(self) -> None:
        """Wait until the last one is stored."""
        self._writer.shutdown()
        self._report_failure()

    def _report_failure(self) -> None:
        if self._written is None or not self._written.done():
            return
        error, self._written = self._written.exception(), None
        if error is not None:
            self._give_up(error)

    def _give_up(self, error: BaseException) -> None:
        self._memory = None
        self._fault_log.report(
            f"{self._what} not kept", f"{error}; a restart will begin {self._without}"
        )
