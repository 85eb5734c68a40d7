# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The goals in force, stored on disk for the next run of a controller."""

import os
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from rclpy.node import Node

from sphere_nmpc.control.goal_memory import GoalMemory
from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.model.goal import GoalSequence
from sphere_nmpc.own_folder import cache_folder
from sphere_nmpc.ros.control_clock import ControlClock


class StoredGoal:
    """File with the goals in force; those of the last run are restored from it once.

    They are restored if that run ended at most `keep` [s, wall] ago, and written by a thread of
    its own, since a disk may take longer than a control period. With 0 there is no file.
    """

    def __init__(self, node: Node, keep: float, clock: ControlClock, fault_log: FaultLog) -> None:
        self._memory = GoalMemory(goal_file(node), keep) if keep > 0.0 else None
        self._clock = clock
        self._fault_log = fault_log
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="stored_goal")
        self._written: Future[None] | None = None
        self.is_settled = False
        """Whether the stored goals have been restored or are superseded by new ones."""

    def restore(self) -> tuple[GoalSequence, float] | None:
        """Return the goals to continue with, and their age [s, wall].

        They are returned at most once, by the first call with a known time; otherwise None is.
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

    def supersede(self) -> None:
        """Do not restore goals: new ones have been received."""
        self.is_settled = True

    def save(self, goals: GoalSequence | None) -> None:
        """Begin to store the goals in force, or that there are none."""
        self._report_failure()
        if self._memory is None or not self.is_settled or self._clock.now() is None:
            return
        self._written = self._writer.submit(
            self._memory.save, goals, self._clock.stamp(), self._clock.simulated
        )

    def close(self) -> None:
        """Wait until the last goals are stored."""
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
        self._fault_log.report("goal not kept", f"{error}; a restart will begin without a goal")


def goal_file(node: Node) -> Path:
    """Return the file for the goal of a node, one for each domain and full name."""
    name = node.get_fully_qualified_name().strip("/").replace("/", ".")
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    return cache_folder() / f"goal.{domain}.{name}.json"
