# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals of a node at the controller of its namespace: topics and service of a client of goals."""

import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import TypeAlias

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Goals, Path
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from sphere_nmpc.control.goal_client import Ending, GoalClient, NavigatorSettings
from sphere_nmpc.control.goal_report import GoalReport
from sphere_nmpc.ros.messages import stamp_to_ros

GoalMessage: TypeAlias = PoseStamped | PointStamped | Goals | Path
_TOPICS: dict[type, str] = {
    PoseStamped: "goal_pose", PointStamped: "goal_point", Goals: "goals", Path: "path",
}


class GoalLink:
    """Publishers of goals, subscription of the status, and client of the service to cancel.

    `update` is to be called at intervals.

    Parameters
    ----------
    node : Node
        The node that sends the goals.
    kinds : sequence of type
        Types of their messages.
    settings : NavigatorSettings
        For how long controller and progress are waited for.
    ended : callable
        Takes the end of each goal.
    """

    def __init__(
        self, node: Node, kinds: Sequence[type[GoalMessage]], settings: NavigatorSettings,
        ended: Callable[[Ending], object],
    ) -> None:
        self.client = GoalClient(settings)
        """Which goal is in force, and how far it is."""
        self.status = DiagnosticStatus()
        """Newest status of the controller."""
        self.values: dict[str, str] = {}
        """Values of the status; empty before the first."""
        self.report = GoalReport()
        """What it says about the goals."""
        self._ended = ended
        self._answer: Future | None = None
        self.publishers = {kind: node.create_publisher(kind, _TOPICS[kind], 1) for kind in kinds}
        """Publisher of each kind."""
        self._cancel_client = node.create_client(Trigger, "controller/cancel")
        self.subscription = node.create_subscription(
            DiagnosticStatus, "controller/status", self._receive, 10
        )

    def begin(
        self, goal: Hashable, stages: Iterable[GoalMessage], pause: float = 0.0,
        until_taken: bool = False,
    ) -> None:
        """Put a goal in force; see `GoalClient.begin`."""
        self.client.begin(goal, iter(stages), pause, until_taken)
        self.update()

    def update(self) -> None:
        """Do what is due."""
        pursuit = self.client.pursuit
        publisher = None if pursuit is None else self.publishers.get(type(pursuit.message))
        can_send = publisher is not None and publisher.get_subscription_count() > 0
        due = self.client.update(
            time.monotonic(), can_send, self._cancel_client.service_is_ready()
        )
        if due.send and (pursuit := self.client.pursuit) is not None:
            pursuit.message.header.stamp = stamp_to_ros(pursuit.stamp)
            self.publishers[type(pursuit.message)].publish(pursuit.message)
        if due.cancel:
            if self._answer is not None:
                self._cancel_client.remove_pending_request(self._answer)
            self._answer = self._cancel_client.call_async(Trigger.Request())
            self._answer.add_done_callback(self._receive_answer)
        for ending in due.ended:
            self._ended(ending)

    def _receive(self, status: DiagnosticStatus) -> None:
        values = {pair.key: pair.value for pair in status.values}
        self.report = GoalReport.of(values)
        self.status, self.values = status, values
        self.client.receive(self.report, time.monotonic())
        self.update()

    def _receive_answer(self, answer: Future) -> None:
        if answer is self._answer:
            self._answer = None
            self.client.cancel_answered()
