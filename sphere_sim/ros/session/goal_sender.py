# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Send a goal once, to a controller that is known to listen, and see it accepted."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from sphere_nmpc.errors import InvalidStateError, SphereNmpcError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.conversions import WORLD_FRAME, pose_from_ros, pose_to_ros

_SAME = 1e-9
"""Largest difference between the goal sent and the goal accepted [mixed units]."""


class GoalNotAcceptedError(SphereNmpcError):
    """No controller listened to the goal, or none accepted it."""


class GoalSender:
    """Publish on ``goal_pose`` and listen to the controller's ``active_goal``.

    Parameters
    ----------
    node : Node
        Owner of the publisher; goal and controller are in its namespace.
    spin : callable
        Serves the node for a moment.
    controller : str, optional
        Name of the controller node.
    """

    def __init__(
        self, node: Node, spin: Callable[[], object], controller: str = "controller"
    ) -> None:
        self._spin = spin
        self._node = node
        self._accepted: Vector | None = None
        active = f"{controller}/active_goal"
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publisher = node.create_publisher(PoseStamped, "goal_pose", 1)
        self._confirmation = node.create_subscription(PoseStamped, active, self._note, latched)

    def wait_for_controller(self, timeout: float) -> None:
        """Wait until the controller is matched, and everybody else who listens to the goal.

        Parameters
        ----------
        timeout : float
            Longest wait [s].

        Raises
        ------
        GoalNotAcceptedError
            If that does not happen in time.
        """
        topic = self._publisher.topic_name
        if not self._wait(timeout, self._is_matched):
            number = self._publisher.get_subscription_count()
            raise GoalNotAcceptedError(
                f"no controller came up within {timeout:g} s: {number} subscribers of {topic}, "
                f"{self._node.count_publishers(self._confirmation.topic_name)} publishers of "
                f"{self._confirmation.topic_name}; is one running in this namespace and domain?"
            )

    def send(self, goal: Vector, shell_radius: float, timeout: float) -> None:
        """Publish the goal, shape (6,), once and wait for it to be in force.

        Raises
        ------
        GoalNotAcceptedError
            If the controller does not confirm it in time.
        """
        self._accepted = None
        # Stamp 0 means now; the controller looks at the frame and the pose only.
        self._publisher.publish(pose_to_ros(goal, 0, shell_radius, WORLD_FRAME))
        if not self._wait(timeout, lambda: self._is_accepted(goal)):
            raise GoalNotAcceptedError(
                f"the goal was sent but not confirmed on {self._confirmation.topic_name} within "
                f"{timeout:g} s; the controller's log says why"
            )

    def _is_matched(self) -> bool:
        matched = self._publisher.get_subscription_count()
        known = self._node.count_subscribers(self._publisher.topic_name)
        heard = self._node.count_publishers(self._confirmation.topic_name)
        return matched >= max(1, known) and heard > 0

    def _is_accepted(self, goal: Vector) -> bool:
        accepted = self._accepted
        return accepted is not None and bool(np.all(np.abs(accepted - goal) < _SAME))

    def _note(self, message: Any) -> None:
        try:
            self._accepted = pose_from_ros(message)
        except InvalidStateError as error:
            self._node.get_logger().warning(f"active_goal is no pose: {error}")

    def _wait(self, timeout: float, condition: Callable[[], bool]) -> bool:
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            self._spin()
            if condition():
                return True
        return False
