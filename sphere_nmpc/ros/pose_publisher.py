# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Publishers of the pose of the robot: pose, odometry and transform."""

from collections.abc import Callable, Iterable
from typing import Any

from geometry_msgs.msg import PoseStamped, TransformStamped, Vector3
from nav_msgs.msg import Odometry
from rclpy.node import Node

from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.cdr import BODY_FRAME
from sphere_nmpc.ros.cdr_messages import pose_message
from sphere_nmpc.ros.messages import odometry_to_ros, pose_to_ros

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # there are no wheels of tf2_msgs, nor of RViz, which needs it
    TFMessage = None


def frame_prefix(node: Node, given: str) -> str:
    """Return the prefix of the robot's frames: as given, or the namespace of its node."""
    return given or f"{node.get_namespace().strip('/')}/".lstrip("/")


class PosePublisher:
    """Publisher of pose and, where they have a subscription, of odometry and transform.

    `prefix` is that of the frame of the body, `under` that of the topics; only without the latter
    there is a transform. `depth` is the number of messages kept for a slow subscriber.
    """

    def __init__(
        self, node: Node, shell_radius: float, prefix: str, world_frame: str, depth: int,
        under: str = "",
    ) -> None:
        self._radius, self._body, self._world = shell_radius, prefix + BODY_FRAME, world_frame
        self._pose = node.create_publisher(PoseStamped, f"{under}pose", depth)
        self._odometry = node.create_publisher(Odometry, f"{under}odom", depth)
        has_transform = TFMessage is not None and not under
        self._transforms = node.create_publisher(TFMessage, "/tf", 100) if has_transform else None

    def messages(
        self, poses: Iterable[tuple[int, Vector]], shown: Vector, stamp: int,
        moving: Callable[[], tuple[Vector, Vector, tuple[Vector, Vector] | None]],
    ) -> list[tuple[Any, Any]]:
        """Return what is to be published, each with its publisher.

        `poses` are states with their stamps [ns]; `shown` is the state of odometry and transform
        at `stamp`. `moving` returns the velocities and the covariances of `odometry_to_ros`.
        """
        found = [
            (self._pose, pose_message(state, at, self._radius, self._world)) for at, state in poses
        ]
        # At 2000 instants a second, messages without a subscriber would take too much time.
        if self._odometry.get_subscription_count() > 0:
            velocity, body_rate, covariances = moving()
            odometry = odometry_to_ros(
                shown, velocity, body_rate, stamp, self._radius, self._body, self._world,
                covariances,
            )
            found.append((self._odometry, odometry))
        if self._transforms and self._transforms.get_subscription_count() > 0:
            message = pose_to_ros(shown, stamp, self._radius, self._world)
            place, turn = message.pose.position, message.pose.orientation
            transform = TransformStamped(header=message.header, child_frame_id=self._body)
            transform.transform.translation = Vector3(x=place.x, y=place.y, z=place.z)
            transform.transform.rotation = turn
            found.append((self._transforms, TFMessage(transforms=[transform])))
        return found
