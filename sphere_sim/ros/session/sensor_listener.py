# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a robot's sensors, as a node receives them for a while."""

import time
from collections.abc import Sequence
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState

from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.ros import cdr
from sphere_nmpc.ros.guarded_node import GuardedNode, spin_for
from sphere_nmpc.ros.startup import start_ros

_KINDS = {"imu": (Imu, cdr.Imu), "joint_states": (JointState, cdr.Joints),
          "pose": (PoseStamped, cdr.Pose)}
_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""QoS as that of the odometry: publishers of either reliability match."""
_PATIENCE = 10.0
"""Longest wait for the next reading of the IMU [s; wall time]."""
_TURN = 0.05
"""Longest wait for a message [s; wall time]."""


def listen(duration: float, words: Sequence[str]) -> dict[str, list[tuple[int, Any]]]:
    """Return what is received for a time [s; ROS clock], from the first reading of the IMU on.

    That is, by topic, for each that has a publisher or a message, the times [ns] of receipt and
    the records of its messages. It ends early where the IMU is silent. `words` are those of ROS.
    """
    start_ros(words)
    node = GuardedNode("estimate")
    seen: dict[str, list[tuple[int, Any]]] = {name: [] for name in _KINDS}

    def take(raw: bytes, name: str, record: Any) -> None:
        # Of 0 while there is no simulated time yet.
        if now := node.get_clock().now().nanoseconds:
            seen[name].append((now, cdr.read(raw, record)))

    try:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        for name, (kind, record) in _KINDS.items():
            node.create_subscription(
                kind, name, lambda raw, name=name, record=record: take(raw, name, record), _QOS,
                raw=True,
            )
        readings, number, since = seen["imu"], 0, time.monotonic()
        while time.monotonic() < since + _PATIENCE and (
            not readings or readings[-1][0] < readings[0][0] + duration * NANOSECONDS
        ):
            spin_for(executor, _TURN)
            if len(readings) > number:
                number, since = len(readings), time.monotonic()
        return {name: found for name, found in seen.items() if found or node.count_publishers(
            node.resolve_topic_name(name))}
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
