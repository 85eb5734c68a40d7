# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Proxy between simulator and controller that disturbs poses, clock and commands.

subscribes  pose_raw, joint_states_raw, /clock_raw, rotor_trajectory, rotor_commands
publishes   pose, joint_states, /clock, rotor_trajectory_raw, rotor_commands_raw
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.ros.messages import stamp_from_ros, stamp_to_ros
from sphere_sim.faults.pose_stream import PoseSample, PoseStream

REMAPPED = {
    "simulator": {
        "pose": "pose_raw", "/clock": "/clock_raw", "rotor_trajectory": "rotor_trajectory_raw",
        "rotor_commands": "rotor_commands_raw", "joint_states": "joint_states_raw",
    }
}
"""Remappings of the nodes with which their messages pass through the proxy."""
_DEPTH = 1000
_NEWEST = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
"""As in the controller: on a busy machine retransmissions in a reliable stream take seconds, and a
clock that lags behind the poses would be an unintended fault."""


class FaultProxy:
    """Proxy of poses, clock and commands; its attributes determine the disturbances.

    Parameters
    ----------
    node : Node
        Owner of publishers and subscriptions.
    rng : Generator
        Source of randomness.
    on_pose : callable
        Called with each undisturbed pose.
    """

    def __init__(
        self, node: Node, rng: np.random.Generator, on_pose: Callable[[PoseStamped], object]
    ) -> None:
        self._on_pose = on_pose
        self.stream = PoseStream(rng)
        """Disturbances of the poses."""
        self.lost: set[str] = set()
        """What is not forwarded at present: poses (and joint states), clock, commands."""
        self.newest: PoseStamped | None = None
        """The newest pose, undisturbed."""
        self.shift = 0
        """Offset that is added to all stamps [ns], and subtracted from those of trajectories."""
        self._now = 0
        self._pose = node.create_publisher(PoseStamped, "pose", _DEPTH)
        self._joints = node.create_publisher(JointState, "joint_states", _DEPTH)
        self._clock = node.create_publisher(Clock, "/clock", _DEPTH)
        self._trajectory = node.create_publisher(JointTrajectory, "rotor_trajectory_raw", 10)
        self._speeds = node.create_publisher(Float64MultiArray, "rotor_commands_raw", 10)
        self._subscriptions = [
            node.create_subscription(PoseStamped, "pose_raw", self._take_pose, _NEWEST),
            node.create_subscription(JointState, "joint_states_raw", self._take_joints, _NEWEST),
            node.create_subscription(Clock, "/clock_raw", self._take_clock, _NEWEST),
            node.create_subscription(
                JointTrajectory, "rotor_trajectory", self._take_trajectory, 10
            ),
            node.create_subscription(
                Float64MultiArray, "rotor_commands", self._take_speeds, 10, raw=True
            ),
        ]

    def _take_pose(self, message: Any) -> None:
        self._on_pose(message)
        place, turn = message.pose.position, message.pose.orientation
        stamp = stamp_from_ros(message.header.stamp)
        if stamp < self._now:
            self.stream.clear()
        self._now = stamp
        self.newest = message
        if "poses" not in self.lost:
            values = (place.x, place.y, turn.w, turn.x, turn.y, turn.z)
            self.stream.enter(stamp, PoseSample(stamp, values, message.header.frame_id))
        for sample in self.stream.leave(stamp):
            self._pose.publish(self._message(sample, place.z))

    def _message(self, sample: PoseSample, height: float) -> PoseStamped:
        message = PoseStamped()
        message.header.stamp = self.shifted(sample.stamp)
        message.header.frame_id = sample.frame
        place, turn = message.pose.position, message.pose.orientation
        place.x, place.y, turn.w, turn.x, turn.y, turn.z = sample.values
        place.z = height
        return message

    def shifted(self, stamp: int) -> Time:
        """Return the stamp that the controller receives for one of the simulator [ns]."""
        return stamp_to_ros(max(0, stamp + self.shift))

    def _take_joints(self, message: Any) -> None:
        if "poses" not in self.lost:
            message.header.stamp = self.shifted(stamp_from_ros(message.header.stamp))
            self._joints.publish(message)

    def _take_clock(self, message: Any) -> None:
        if "clock" not in self.lost:
            message.clock = self.shifted(stamp_from_ros(message.clock))
            self._clock.publish(message)

    def _take_trajectory(self, message: Any) -> None:
        if "commands" in self.lost:
            return
        stamp = stamp_from_ros(message.header.stamp)
        if stamp:
            message.header.stamp = stamp_to_ros(max(0, stamp - self.shift))
        self._trajectory.publish(message)

    def _take_speeds(self, serialized: bytes) -> None:
        if "commands" not in self.lost:
            self._speeds.publish(serialized)
