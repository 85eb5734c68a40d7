# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Sender of goals, which waits for the controller and its confirmation, and cancels them."""

import math
import time
from collections.abc import Callable

from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Goals
from rclpy.node import Node
from std_srvs.srv import Trigger

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.quantity import stamp_text
from sphere_nmpc.ros.graph_monitor import type_name
from sphere_nmpc.ros.messages import stamp_to_ros
from sphere_sim.ros.session.controller_status import ControllerStatus
from sphere_sim.ros.session.goal_messages import GoalMessage
from sphere_sim.ros.session.serving import serve_until

_TOPICS: dict[type, str] = {PoseStamped: "goal_pose", PointStamped: "goal_point", Goals: "goals"}


class GoalNotAcceptedError(SphereNmpcError):
    """No controller subscribes to goals, or none accepted the goal."""


class NotCancelledError(SphereNmpcError):
    """No controller has confirmed that it has cancelled its goals."""


class GoalSender:
    """Publisher of one kind of goals, with the ``goal_stamp`` of the status as confirmation.

    Both are in the namespace of `node`, which `spin` serves for a moment.
    """

    def __init__(
        self, node: Node, spin: Callable[[], object], kind: type[GoalMessage] = PoseStamped
    ) -> None:
        self._spin = spin
        self._node = node
        self.status = ControllerStatus(node)
        """Status of the controller."""
        self.stamp = ""
        """Stamp of the goals that were sent last, as the status has it; empty before."""
        self._publisher = node.create_publisher(kind, _TOPICS[kind], 1)
        self._cancel = node.create_client(Trigger, "controller/cancel")

    @property
    def is_in_force(self) -> bool:
        """Whether the goals in force, by the newest status, are those that were sent last."""
        return self.stamp != "" and self.status.progress.stamp == self.stamp

    def wait_for_controller(self, timeout: float) -> None:
        """Wait until the controller is matched, and every other subscriber of the goal.

        `GoalNotAcceptedError` is raised if that does not happen within `timeout` [s].
        """
        topic = self._publisher.topic_name
        if not serve_until(self._spin, self._is_matched, timeout):
            number = self._publisher.get_subscription_count()
            raise GoalNotAcceptedError(
                f"no controller was ready within {timeout:g} s: {number} subscribers of {topic}, "
                f"{self.status.publishers} publishers of {self.status.topic}; is one running in "
                "this namespace and domain?"
            )

    def send(self, message: GoalMessage, timeout: float, repeat: float = math.inf) -> None:
        """Publish goals and wait for them to be in force, at most `timeout` [s].

        Without confirmation they are published again after `repeat` [s, wall time], as a
        controller that was killed stays matched for some time. `GoalNotAcceptedError` is raised
        if the controller does not confirm them in time.
        """
        # The controller knows them again by it, and does not take it for a time.
        stamp = time.time_ns()
        message.header.stamp = stamp_to_ros(stamp)
        self.stamp = stamp_text(stamp)
        end = time.monotonic() + timeout
        while (left := end - time.monotonic()) > 0.0:
            self._publisher.publish(message)
            if serve_until(self._spin, lambda: self.is_in_force, min(left, repeat)):
                return
        raise GoalNotAcceptedError(
            f"the goal was sent but not confirmed on {self.status.topic} within {timeout:g} s; "
            "the controller's log names the reason"
        )

    def cancel(self, timeout: float) -> None:
        """Cancel the goals in force, at most within `timeout` [s].

        `NotCancelledError` is raised if the controller does not answer in time.
        """
        service, end = self._cancel.srv_name, time.monotonic() + timeout
        if not serve_until(self._spin, self._cancel.service_is_ready, timeout):
            raise NotCancelledError(f"there is no service {service}")
        answer = self._cancel.call_async(Trigger.Request())
        if not serve_until(self._spin, answer.done, end - time.monotonic()):
            raise NotCancelledError(f"no answer of {service} within {timeout:g} s")

    def _is_matched(self) -> bool:
        matched = self._publisher.get_subscription_count()
        found = self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
        known = sum(info.topic_type == type_name(self._publisher.msg_type) for info in found)
        return matched >= max(1, known) and self.status.count > 0
