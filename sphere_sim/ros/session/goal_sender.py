# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Sender of goals for programs that wait: for the controller, its confirmation, and the end."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from sphere_nmpc.control.goal_client import Ending, NavigatorSettings, Outcome
from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.quantities import counted
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.ros.goal_link import GoalLink, GoalMessage
from sphere_nmpc.ros.graph_monitor import type_name
from sphere_sim.ros.session.serving import serve_until

_REMEDIES = {
    Kind.DISABLED.value: ("controller/enable", "true"),
    Kind.CLOCK_STOPPED.value: ("simulator/pause", "false"),
}
"""Service that ends a state of the controller, and what to send to it."""
_MOMENT = 1.0
"""Wait for a controller of which nothing is heard [s]."""


class GoalNotAcceptedError(SphereNmpcError):
    """No controller subscribes to goals, or none accepted the goal."""


class GoalSender(GoalLink):
    """Link that is served by `spin`, for a moment each time, while it waits."""

    def __init__(
        self, node: Node, spin: Callable[[], object], settings: NavigatorSettings,
        kind: type[GoalMessage] = PoseStamped,
    ) -> None:
        self.ending: Ending | None = None
        """End of the goal that was sent last; None before."""
        super().__init__(node, [kind], settings, self._note)
        self._node, self._serve, self._number = node, spin, 0
        self._publisher, self._topic = self.publishers[kind], self.subscription.topic_name

    def wait_for_controller(
        self, timeout: float, report: Callable[[str], object] = lambda line: None
    ) -> None:
        """Wait until the controller is matched, and every other subscriber of the goal.

        `report` takes a line where that takes longer. `GoalNotAcceptedError` is raised
        if it does not happen within `timeout` [s].
        """
        moment = min(_MOMENT, timeout)
        if serve_until(self._serve, self._is_matched, moment):
            return
        report(f"waiting up to {timeout:g} s for a controller: {self._found()}")
        if not serve_until(self._serve, self._is_matched, timeout - moment):
            raise GoalNotAcceptedError(
                f"no controller was ready within {timeout:g} s: {self._found()}; is one running "
                "in this namespace and domain?"
            )

    def _found(self) -> str:
        """Return how many others have been found on the topics."""
        takers = counted(self._publisher.get_subscription_count(), "subscriber")
        sources = counted(self.subscription.get_publisher_count(), "publisher")
        return f"{takers} of {self._publisher.topic_name}, {sources} of {self._topic}"

    def send(self, message: GoalMessage, timeout: float, until_taken: bool = True) -> None:
        """Send goals and wait for them to be in force, at most `timeout` [s].

        They are left to the controller then, unless not `until_taken`. `GoalNotAcceptedError` is
        raised if the controller does not confirm them in time.
        """
        self.ending, self._number = None, self._number + 1
        self.begin(self._number, [message], until_taken=until_taken)
        serve_until(self.spin, lambda: self.client.report or self.ending, timeout)
        if until_taken and self.ending is not None and self.ending.outcome is Outcome.ABORTED:
            raise GoalNotAcceptedError(self.ending.reason)
        if self.client.report is None and self.ending is None:
            self.client.abandon("not confirmed")
            raise GoalNotAcceptedError(
                f"the goal was sent but not confirmed on {self._topic} within "
                f"{timeout:g} s; the controller's log names the reason"
            )

    def spin(self) -> None:
        """Serve the node for a moment, and do what is due."""
        self._serve()
        self.update()

    def obstacle(self) -> str:
        """Return what keeps the controller from moving to its goal, with the remedy, or ""."""
        mode = self.report.mode
        words = [mode] if mode == Kind.DISABLED.value else []
        if self.status.level != DiagnosticStatus.OK:
            words.append(self.status.message)
        # Longer than other foreign texts, as the remedy is at the end.
        return "; ".join(self._remedy(word) or f"{word!r:.400}" for word in words)

    def _remedy(self, word: str) -> str:
        if word not in _REMEDIES:
            return ""
        service, data = _REMEDIES[word]
        name = self._node.resolve_service_name(service)
        return f'{word}: ros2 service call {name} std_srvs/srv/SetBool "{{data: {data}}}"'

    def _note(self, ending: Ending) -> None:
        if ending.goal == self._number:
            self.ending = ending

    def _is_matched(self) -> bool:
        matched = self._publisher.get_subscription_count()
        found = self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
        known = sum(info.topic_type == type_name(self._publisher.msg_type) for info in found)
        return matched >= max(1, known) and bool(self.values)
