# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Publisher of the simulated robot's state and of the simulated clock."""

import time
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState

from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.cdr import WORLD_FRAME
from sphere_nmpc.ros.cdr_messages import clock_message, imu_message, joint_states_message
from sphere_nmpc.ros.pose_publisher import PosePublisher
from sphere_sim.world.imu_sensor import ImuReading, SimulatedImuSettings
from sphere_sim.world.plant.rigid_body.mjcf import IMU
from sphere_sim.world.simulator import Simulator

_DEPTH = 1000
"""Messages kept for a subscriber that is slow: at full speed a sample takes milliseconds."""


class StatePublisher:
    """Publish pose, odometry, IMU, joint states and, last of all, the clock unless not `clocked`.

    `prefix` is that of the frames of body and IMU, which is read while it has a subscription.
    With `has_odometry` it always is, and another node publishes pose, odometry and transform:
    those of here are the ground truth, and the joint states are read together with the IMU.
    """

    def __init__(
        self, node: Node, shell_radius: float, prefix: str = "", world_frame: str = WORLD_FRAME,
        clocked: bool = True, has_odometry: bool = False, imu: SimulatedImuSettings | None = None,
    ) -> None:
        self._imu_frame, self._has_odometry = prefix + IMU, has_odometry
        self._imu_settings = imu or SimulatedImuSettings()
        self.epoch = 0
        """Stamp of simulated time 0 [ns]."""
        self._pose = PosePublisher(
            node, shell_radius, prefix, world_frame, _DEPTH,
            under="ground_truth/" if has_odometry else "",
        )
        self._imu = node.create_publisher(Imu, "imu", _DEPTH)
        self._joints = node.create_publisher(JointState, "joint_states", _DEPTH)
        self._clock = node.create_publisher(Clock, "/clock", _DEPTH) if clocked else None
        self._last: list[tuple[Any, Any]] = []

    def publish(self, simulator: Simulator) -> None:
        """Publish the present instant; the measurement noise is drawn once for it."""
        now, plant = self.epoch + simulator.now, simulator.plant
        poses = simulator.poses()
        # Tools should not draw the poses of a late or slow sensor: they get the true state then.
        measured = poses[-1][1] if simulator.settings.is_sensor_plain else plant.state
        self._last = self._pose.messages(
            [(self.epoch + stamp, seen) for stamp, seen in poses], measured, now,
            lambda: (plant.velocity, plant.body_rate, None),
        )
        is_wanted = self._has_odometry or self._imu.get_subscription_count() > 0
        if is_wanted is not bool(simulator.imu):
            simulator.fit_imu(self._imu_settings if is_wanted else None)
        for reading in simulator.imu_readings():
            self._add_reading(reading)
        # At 2000 instants a second, messages without a subscriber would take too much time.
        if not self._has_odometry and self._joints.get_subscription_count() > 0:
            self._add_joints(plant.rotor_angles, plant.rotor_speeds, plant.rotor_torques, now)
        # The clock comes last, so that a node that acts on it has the pose of that instant.
        if self._clock is not None:
            self._last.append((self._clock, clock_message(now)))
        self.repeat()

    def _add_reading(self, reading: ImuReading) -> None:
        stamp, deviations = self.epoch + reading.stamp, self._imu_settings.deviations
        message = imu_message(reading.rate, reading.force, deviations, stamp, self._imu_frame)
        self._last.append((self._imu, message))
        if self._has_odometry:
            self._add_joints(reading.angles, reading.speeds, reading.torques, stamp)

    def _add_joints(self, angles: Vector, speeds: Vector, torques: Vector, stamp: int) -> None:
        joints = joint_states_message(angles, speeds, torques, stamp)
        self._last.append((self._joints, joints))

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
