# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The goal in force, stored on disk for the next run of a controller."""

import os
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from rclpy.node import Node

from sphere_nmpc.control.goal_memory import GoalMemory, cache_folder
from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.controller.control_clock import ControlClock


class StoredGoal:
    """File with the goal in force; the goal of the last run is restored from it once.

    It is restored if that run ended at most `keep` [s, wall] ago, and written by a thread of its
    own, since a disk may take longer than a control period.
    """

    def __init__(self, node: Node, keep: float, clock: ControlClock, fault_log: FaultLog) -> None:
        self._memory: GoalMemory | None = GoalMemory(goal_file(node), keep)
        self._clock = clock
        self._fault_log = fault_log
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="stored_goal")
        self._written: Future[None] | None = None
        self.is_settled = False
        """Whether the stored goal has been restored or is superseded by a new one."""

    def restore(self) -> tuple[Vector, float] | None:
        """Return the goal to continue with, shape (6,), and its age [s, wall].

        It is returned at most once, by the first call with a known time; otherwise None is.
        """
        if self.is_settled or self._clock.now() is None:
            return None
        self.is_settled = True
        if self._memory is None:
            return None
        return self._memory.recall(self._clock.stamp(), self._clock.simulated)

    def supersede(self) -> None:
        """Do not restore a goal: a new one has been received."""
        self.is_settled = True

    def save(self, goal: Vector | None) -> None:
        """Begin to store the goal in force, shape (6,), or that there is none."""
        self._report_failure()
        if self._memory is None or not self.is_settled or self._clock.now() is None:
            return
        self._written = self._writer.submit(
            self._memory.save, goal, self._clock.stamp(), self._clock.simulated
        )

    def close(self) -> None:
        """Wait until the last goal is stored."""
        self._writer.shutdown()
        self._report_failure()

    def _report_failure(self) -> None:
        if self._written is None or not self._written.done():
            return
        error, self._written = self._written.exception(), None
        if error is not None:
            self._memory = None
            self._fault_log.report(
                "goal not kept", f"{error}; a restart will begin without a goal"
            )


def goal_file(node: Node) -> Path:
    """Return the file for the goal of a node, one for each domain and full name."""
    name = node.get_fully_qualified_name().strip("/").replace("/", ".")
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    return cache_folder() / "goals" / f"{domain}.{name}.json"
