# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Publisher of the simulated robot's state and of the simulated clock."""

import time
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from sphere_nmpc.ros.cdr import (
    BODY_FRAME,
    WORLD_FRAME,
    clock_message,
    joint_states_message,
    pose_message,
)
from sphere_nmpc.ros.messages import odometry_to_ros, pose_to_ros, transform_from_pose
from sphere_sim.world.simulator import Simulator

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # there are no wheels of tf2_msgs, nor of RViz, which needs it
    TFMessage = None


_DEPTH = 1000
"""Messages kept for a subscriber that is slow: at full speed a sample takes milliseconds."""


class StatePublisher:
    """Publish pose, odometry, joint states and, last of all, the clock unless not `clocked`."""

    def __init__(
        self, node: Node, shell_radius: float, body_frame: str = BODY_FRAME,
        world_frame: str = WORLD_FRAME, clocked: bool = True,
    ) -> None:
        self._radius = shell_radius
        self._body, self._world = body_frame, world_frame
        self.epoch = 0
        """Stamp of simulated time 0 [ns]."""
        self._pose = node.create_publisher(PoseStamped, "pose", _DEPTH)
        self._odometry = node.create_publisher(Odometry, "odom", _DEPTH)
        self._joints = node.create_publisher(JointState, "joint_states", _DEPTH)
        self._transforms = TFMessage and node.create_publisher(TFMessage, "/tf", 100)
        self._clock = node.create_publisher(Clock, "/clock", _DEPTH) if clocked else None
        self._last: list[tuple[Any, Any]] = []

    def publish(self, simulator: Simulator) -> None:
        """Publish the present instant; the measurement noise is drawn once for it."""
        now, plant = self.epoch + simulator.now, simulator.plant
        poses = simulator.poses()
        # Tools should not draw the poses of a late or slow sensor: they get the true state then.
        measured = poses[-1][1] if simulator.settings.is_sensor_plain else plant.state
        self._last = [
            (self._pose, pose_message(seen, self.epoch + stamp, self._radius, self._world))
            for stamp, seen in poses
        ]
        # At 2000 instants a second, messages without a subscriber would take too much time.
        if self._odometry.get_subscription_count() > 0:
            odometry = odometry_to_ros(
                measured, plant.velocity, plant.body_rate, now, self._radius, self._body,
                self._world,
            )
            self._last.append((self._odometry, odometry))
        if self._joints.get_subscription_count() > 0:
            joints = joint_states_message(
                plant.rotor_angles, plant.rotor_speeds, plant.rotor_torques, now
            )
            self._last.append((self._joints, joints))
        if self._transforms and self._transforms.get_subscription_count() > 0:
            pose = pose_to_ros(measured, now, self._radius, self._world)
            transform = transform_from_pose(pose, self._body)
            self._last.append((self._transforms, TFMessage(transforms=[transform])))
        # The clock comes last, so that a node that acts on it has the pose of that instant.
        if self._clock is not None:
            self._last.append((self._clock, clock_message(now)))
        self.repeat()

    def flush(self, timeout: float) -> None:
        """Wait until each reliable subscriber has received all messages, at most `timeout` [s].

        At full speed a subscriber is late; if it is ended then, the end of the run must not be
        missing.
        """
        end = time.monotonic() + timeout
        for publisher in {publisher for publisher, _ in self._last}:
            left = max(0.0, end - time.monotonic())
            publisher.wait_for_all_acked(Duration(seconds=left))

    def repeat(self) -> None:
        """Publish the last instant again, for nodes that subscribed while time stood still."""
        for publisher, message in self._last:
            publisher.publish(message)
