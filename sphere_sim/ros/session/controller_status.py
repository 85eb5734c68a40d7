# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Newest status of the controller, for who sends goals: progress, and what is missing."""

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from sphere_nmpc.conditions import Kind
from sphere_sim.recording.message_fields import ReportedProgress, reported_progress

_REMEDIES = {
    Kind.DISABLED.value: ("controller/enable", "true"),
    Kind.CLOCK_STOPPED.value: ("simulator/pause", "false"),
}
"""Service that ends a state of the controller, and what to send to it."""


class ControllerStatus:
    """Subscriber of the status of the controller in the namespace of a node."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._message = DiagnosticStatus()
        self.count = 0
        """Number of messages received."""
        self.values: Mapping[str, str] = {}
        """Values of the newest one; empty before the first."""
        self.progress = ReportedProgress()
        self._subscription = node.create_subscription(
            DiagnosticStatus, "controller/status", self._take, 1
        )
        self.topic = self._subscription.topic_name
        """Full name of the topic."""

    @property
    def publishers(self) -> int:
        """Number of publishers whose messages arrive."""
        return self._subscription.get_publisher_count()

    @property
    def mode(self) -> str:
        """Mode of the controller; empty before the first message."""
        return self.values.get("mode", "")

    def obstacle(self) -> str:
        """Return what keeps the controller from moving to its goal, with the remedy, or ""."""
        words = [self.mode] if self.mode == Kind.DISABLED.value else []
        if self._message.level != DiagnosticStatus.OK:
            words.append(self._message.message)
        # Longer than other foreign texts, as the remedy is at the end.
        return "; ".join(self._remedy(word) or f"{word!r:.400}" for word in words)

    def _remedy(self, word: str) -> str:
        if word not in _REMEDIES:
            return ""
        service, data = _REMEDIES[word]
        name = self._node.resolve_service_name(service)
        return f'{word}: ros2 service call {name} std_srvs/srv/SetBool "{{data: {data}}}"'

    def _take(self, status: DiagnosticStatus) -> None:
        self._message = status
        self.count += 1
        self.values = {pair.key: pair.value for pair in status.values}
        self.progress = reported_progress(self.values)
