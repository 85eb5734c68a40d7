# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Stands between simulator and controller and spoils what passes: poses, clock, trajectories.

subscribes  pose_raw, /clock_raw, rotor_trajectory
publishes   pose, /clock, rotor_trajectory_raw
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.ros.conversions import stamp_from_ros, stamp_to_ros
from sphere_sim.faults.pose_stream import PoseSample, PoseStream

REMAPPED = {
    "simulator": {
        "pose": "pose_raw", "/clock": "/clock_raw", "rotor_trajectory": "rotor_trajectory_raw",
    }
}
"""Names that the nodes need for the proxy to stand between them."""
_DEPTH = 1000
_NEWEST = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
"""As the controller listens: on a busy machine repairs of a reliable stream take seconds, and a
clock that is late behind the poses would be a fault that nobody asked for."""


class FaultProxy:
    """Pass everything on, as `stream` and `shift` say.

    Parameters
    ----------
    node : Node
        Owner of publishers and subscriptions.
    rng : Generator
        Behind all chance.
    witness : callable
        Shown each pose as it came in.
    """

    def __init__(
        self, node: Node, rng: np.random.Generator, witness: Callable[[PoseStamped], object]
    ) -> None:
        self._witness = witness
        self.stream = PoseStream(rng)
        """What happens to the poses."""
        self.clock_passes = True
        """Whether the controller hears the clock."""
        self.shift = 0
        """What is added to the time of the world [ns]; trajectories are shifted back by it."""
        self._now = 0
        self._pose = node.create_publisher(PoseStamped, "pose", _DEPTH)
        self._clock = node.create_publisher(Clock, "/clock", _DEPTH)
        self._trajectory = node.create_publisher(JointTrajectory, "rotor_trajectory_raw", 10)
        self._heard = [
            node.create_subscription(PoseStamped, "pose_raw", self._take_pose, _NEWEST),
            node.create_subscription(Clock, "/clock_raw", self._take_clock, _NEWEST),
            node.create_subscription(
                JointTrajectory, "rotor_trajectory", self._take_trajectory, 10
            ),
        ]

    def _take_pose(self, message: Any) -> None:
        self._witness(message)
        place, turn = message.pose.position, message.pose.orientation
        stamp = stamp_from_ros(message.header.stamp)
        if stamp < self._now:
            self.stream.clear()
        self._now = stamp
        values = (place.x, place.y, turn.w, turn.x, turn.y, turn.z)
        self.stream.enter(stamp, PoseSample(stamp, values, message.header.frame_id))
        for sample in self.stream.leave(stamp):
            self._pose.publish(self._message(sample, place.z))

    def _message(self, sample: PoseSample, height: float) -> PoseStamped:
        message = PoseStamped()
        message.header.stamp = stamp_to_ros(max(0, sample.stamp + self.shift))
        message.header.frame_id = sample.frame
        place, turn = message.pose.position, message.pose.orientation
        place.x, place.y, turn.w, turn.x, turn.y, turn.z = sample.values
        place.z = height
        return message

    def _take_clock(self, message: Any) -> None:
        if self.clock_passes:
            message.clock = stamp_to_ros(max(0, stamp_from_ros(message.clock) + self.shift))
            self._clock.publish(message)

    def _take_trajectory(self, message: Any) -> None:
        stamp = stamp_from_ros(message.header.stamp)
        if stamp:
            message.header.stamp = stamp_to_ros(max(0, stamp - self.shift))
        self._trajectory.publish(message)
