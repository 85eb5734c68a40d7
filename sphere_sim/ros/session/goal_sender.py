# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Sender of goals, which waits for the controller and its confirmation."""

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from sphere_nmpc.errors import InvalidStateError, SphereNmpcError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.messages import pose_from_ros, pose_to_ros
from sphere_sim.ros.session.serving import serve_until

_SAME = 1e-9
"""Largest difference between the goal sent and the goal accepted [mixed units]."""


class GoalNotAcceptedError(SphereNmpcError):
    """No controller subscribes to goals, or none accepted the goal."""


class GoalSender:
    """Publisher on ``goal_pose`` with the controller's ``active_goal`` as confirmation.

    Both are in the namespace of `node`, which `spin` serves for a moment.
    """

    def __init__(self, node: Node, spin: Callable[[], object]) -> None:
        self._spin = spin
        self._node = node
        self._accepted: Vector | None = None
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publisher = node.create_publisher(PoseStamped, "goal_pose", 1)
        self._confirmation = node.create_subscription(
            PoseStamped, "controller/active_goal", self._note, latched
        )

    def wait_for_controller(self, timeout: float) -> None:
        """Wait until the controller is matched, and every other subscriber of the goal.

        `GoalNotAcceptedError` is raised if that does not happen within `timeout` [s].
        """
        topic = self._publisher.topic_name
        if not serve_until(self._spin, self._is_matched, timeout):
            number = self._publisher.get_subscription_count()
            raise GoalNotAcceptedError(
                f"no controller was ready within {timeout:g} s: {number} subscribers of {topic}, "
                f"{self._node.count_publishers(self._confirmation.topic_name)} publishers of "
                f"{self._confirmation.topic_name}; is one running in this namespace and domain?"
            )

    def send(
        self, goal: Vector, shell_radius: float, timeout: float, repeat: float = math.inf
    ) -> None:
        """Publish the goal, shape (6,), and wait for it to be in force, at most `timeout` [s].

        Without confirmation it is published again after `repeat` [s, wall time], as a controller
        that was killed stays matched for some time. `GoalNotAcceptedError` is raised if the
        controller does not confirm it in time.
        """
        self._accepted = None
        end = time.monotonic() + timeout
        while (left := end - time.monotonic()) > 0.0:
            # Without a frame it is in that of the controller; stamp 0 means now.
            self._publisher.publish(pose_to_ros(goal, 0, shell_radius, frame=""))
            if serve_until(self._spin, lambda: self._is_accepted(goal), min(left, repeat)):
                return
        raise GoalNotAcceptedError(
            f"the goal was sent but not confirmed on {self._confirmation.topic_name} within "
            f"{timeout:g} s; the controller's log names the reason"
        )

    def _is_matched(self) -> bool:
        matched = self._publisher.get_subscription_count()
        known = self._node.count_subscribers(self._publisher.topic_name)
        confirming = self._node.count_publishers(self._confirmation.topic_name)
        return matched >= max(1, known) and confirming > 0

    def _is_accepted(self, goal: Vector) -> bool:
        accepted = self._accepted
        return accepted is not None and bool(np.all(np.abs(accepted - goal) < _SAME))

    def _note(self, message: Any) -> None:
        try:
            self._accepted = pose_from_ros(message)
        except InvalidStateError as error:
            self._node.get_logger().warning(f"active_goal is no pose: {error}")
