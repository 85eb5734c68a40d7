# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the viewer hears: the newest message of each topic, as often as it looks."""

import time
from dataclasses import replace
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.model.state import POSITION
from sphere_nmpc.ros.conversions import (
    framed_pose_from_ros,
    joint_states_from_ros,
    pose_from_ros,
    seconds,
    stamp_from_ros,
)
from sphere_sim.viewer.frame import DEFAULT_RADIUS, Frame
from sphere_sim.viewer.health import Health

_STANDSTILL = 0.5
"""Wall time without a newer stamp after which time is said to stand still [s]."""
_FASTEST = 20.0
"""A sphere that moves faster was put somewhere else [m/s]."""
_LONGEST_PLAN = 400
"""Poses of a plan that are looked at."""


class ViewerInputs:
    """Subscribe to the robot's topics and keep a frame of what they say.

    A depth of one and best effort: what is not looked at costs nothing, and nobody waits for a
    viewer.

    Parameters
    ----------
    node : Node
        Owner of the subscriptions; the robot is in its namespace.
    controller : str
        Name of the controller node.
    """

    def __init__(self, node: Node, controller: str = "controller") -> None:
        self.frame = Frame()
        """What is known."""
        self.health = Health()
        self.heard = 0
        """Number of messages so far."""
        self._node = node
        self._reporter = f"{node.get_namespace()}/{controller}:".lstrip("/")
        self._status_topic = f"{controller}/status"
        self._radius: float | None = None
        self._moved_at = time.monotonic()
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for kind, topic, take, qos in (
            (PoseStamped, "pose", self._take_pose, newest),
            (JointState, "joint_states", self._take_joints, newest),
            (PoseStamped, f"{controller}/active_goal", self._take_goal, latched),
            (Path, f"{controller}/predicted_path", self._take_plan, newest),
            (DiagnosticStatus, self._status_topic, self._take_status, newest),
            (DiagnosticArray, "/diagnostics", self._take_diagnostics, 10),
        ):
            node.create_subscription(kind, topic, take, qos)

    @property
    def stands_still(self) -> bool:
        """Whether poses arrive, or arrived last, but always that of the same instant."""
        pose_at = self.health.pose_at
        return pose_at is not None and pose_at - self._moved_at > _STANDSTILL

    def newest(self) -> Frame:
        """Return the frame, and forget that it was a fresh one."""
        frame, self.frame = self.frame, replace(self.frame, fresh=False)
        self.health.controllers = self._node.count_publishers(self._status_topic)
        return replace(frame, alerts=self.health.alerts(time.monotonic()))

    def _take_pose(self, message: PoseStamped) -> None:
        now = self._note()
        try:
            state = framed_pose_from_ros(message)
        except InvalidStateError as error:
            self.health.refused = str(error)
            return
        self.health.refused, self.health.pose_at = "", now
        stamp, last = seconds(stamp_from_ros(message.header.stamp)), self.frame
        if stamp != last.time:
            self._moved_at = now
        elapsed = stamp - last.time
        fresh = last.fresh or (last.state is not None and (
            elapsed < 0.0 or float(np.linalg.norm(state[POSITION] - last.state[POSITION]))
            > _FASTEST * elapsed + 0.1
        ))
        # Messages without a height are of somebody who thinks in the plane.
        height = float(message.pose.position.z)
        radius = height if height > 1e-3 else DEFAULT_RADIUS
        self.frame = replace(last, time=stamp, state=state, radius=radius, fresh=fresh)

    def _take_joints(self, message: JointState) -> None:
        self._note()
        try:
            _, speeds, torques = joint_states_from_ros(message)
        except (InvalidInputError, IndexError):
            return  # other joints, or without one of the three
        self.frame = replace(self.frame, rotor_speeds=speeds, rotor_torques=torques)

    def _take_goal(self, message: PoseStamped) -> None:
        self._note()
        try:
            self.frame = replace(self.frame, goal=pose_from_ros(message))
        except InvalidStateError:
            return

    def _take_plan(self, message: Path) -> None:
        self.health.controller_at = self._note()
        try:
            states = [pose_from_ros(pose) for pose in message.poses[:_LONGEST_PLAN]]
        except InvalidStateError:
            return
        self.frame = replace(self.frame, plan=np.array(states).reshape(-1, 6))

    def _take_status(self, message: DiagnosticStatus) -> None:
        self.health.controller_at = self._note()
        values = {pair.key: pair.value for pair in message.values}
        solved = _number(values, "solve_time_s")
        # A plan that holds has arrived. Of a problem of least time the value is the time left.
        holds = values.get("plan") == "holding"
        to_go = 0.0 if holds else _number(values, "arrival_s") - _number(values, "time_s")
        self.frame = replace(
            self.frame,
            cost=_number(values, "cost") if np.isnan(to_go) else float("nan"),
            to_go=to_go,
            # Where nothing was solved it is zero.
            solve_time=solved if solved > 0.0 else float("nan"),
            strategy=values.get("strategy", ""),
            mode=values.get("mode", ""),
        )

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        now = self._note()
        if any(status.name.startswith(self._reporter) for status in message.status):
            self.health.controller_at = now

    def _note(self) -> float:
        self.heard += 1
        return time.monotonic()


def _number(values: dict[str, Any], key: str) -> float:
    try:
        return float(values.get(key, "nan"))
    except ValueError:
        return float("nan")
