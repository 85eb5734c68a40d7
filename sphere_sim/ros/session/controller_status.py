# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Status of the controller, from which a sender of a goal learns what else is missing."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from sphere_nmpc.control.decision import Mode
from sphere_sim.ros.session.serving import serve_until

_REMEDIES = {
    Mode.DISABLED.value: ("controller/enable", "true"),
    Mode.CLOCK_STOPPED.value: ("simulator/pause", "false"),
}
"""Service that ends a state of the controller, and what to send to it."""


class ControllerStatus:
    """Subscriber of the status of the controller.

    Parameters
    ----------
    node : Node
        Owner of the subscription; the controller is in its namespace.
    spin : callable
        Serves the node for a moment.
    """

    def __init__(self, node: Node, spin: Callable[[], object]) -> None:
        self._node = node
        self._spin = spin
        self._newest: DiagnosticStatus | None = None
        self.topic = node.create_subscription(
            DiagnosticStatus, "controller/status", self._take, 1
        ).topic_name
        """Full name of the topic."""

    def obstacle(self, timeout: float) -> str | None:
        """Return what keeps the controller from moving to a goal that it has just accepted.

        Parameters
        ----------
        timeout : float
            Longest wait for a status [s].

        Returns
        -------
        str or None
            The reason with the remedy, empty where nothing does; None if there was no status.
        """
        self._newest = None
        # The newest decision may be one of before the goal.
        if not serve_until(
            self._spin, lambda: self._newest and _mode(self._newest) != Mode.NO_GOAL.value, timeout
        ):
            return None
        return self._reason(self._newest) if self._newest else None

    def _reason(self, status: DiagnosticStatus) -> str:
        words = [Mode.DISABLED.value] if _mode(status) == Mode.DISABLED.value else []
        if status.level != DiagnosticStatus.OK:
            words.append(status.message)
        # Longer than other foreign texts, as the remedy is at the end.
        return "; ".join(self._remedy(word) or f"{word!r:.400}" for word in words)

    def _remedy(self, word: str) -> str:
        if word not in _REMEDIES:
            return ""
        service, data = _REMEDIES[word]
        name = self._node.resolve_service_name(service)
        return f'{word}: ros2 service call {name} std_srvs/srv/SetBool "{{data: {data}}}"'

    def _take(self, status: DiagnosticStatus) -> None:
        self._newest = status


def _mode(status: DiagnosticStatus) -> str:
    return next((pair.value for pair in status.values if pair.key == "mode"), "")
