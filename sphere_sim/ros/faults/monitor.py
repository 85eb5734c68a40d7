# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitor of all topics, independent of the nodes under test."""

import math
from contextlib import suppress
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.ros.messages import (
    hold_from_trajectory,
    joint_states_from_ros,
    pose_from_ros,
    stamp_from_ros,
)
from sphere_sim.faults.limits import LimitCheck
from sphere_sim.ros.session.goal_run import GoalRun

_DEPTH = 1000
_AT_REST = 1e-3
"""Speed below which a rotor rests [rad/s]."""


class ContinuousTime:
    """Continuous time from stamps that restart with each new simulator."""

    def __init__(self) -> None:
        self._before = self._last = 0

    def of(self, stamp: int) -> float:
        """Return the continuous time [s] of a stamp [ns]."""
        if stamp < self._last - NANOSECONDS:
            self._before += self._last
        self._last = stamp
        return (self._before + stamp) / NANOSECONDS


class FaultMonitor:
    """Monitor of limits, of the run to the goal, and of logs and diagnostics.

    Parameters
    ----------
    node : Node
        Owner of the subscriptions.
    robot : RobotParameters
        Parameters with the limits.
    servo_error : float
        See `LimitCheck`.
    """

    def __init__(self, node: Node, robot: RobotParameters, servo_error: float) -> None:
        self.limits = LimitCheck(
            robot.max_rotor_speed, robot.max_rotor_acceleration, servo_error
        )
        self.run: GoalRun | None = None
        """The run to the goal, judged by the undisturbed poses."""
        self.time = 0.0
        """Simulated time since the start, continued when the simulator is restarted [s]."""
        self._spacing = 0.0
        self.moving_until = 0.0
        """Time at which a rotor last turned [s]."""
        self.messages: list[str] = []
        """Log lines, messages of diagnostics and names of counters that rose."""
        self._pose_time, self._joint_time = ContinuousTime(), ContinuousTime()
        self._counters: dict[str, float] = {}
        for kind, topic, take in (
            (JointTrajectory, "rotor_trajectory", self._take_sent),
            (JointTrajectory, "rotor_trajectory_raw", self._take_delivered),
            (Float64MultiArray, "rotor_commands", self._take_command),
            (JointState, "joint_states_raw", self._take_joints),
            (DiagnosticArray, "/diagnostics", self._take_diagnostics),
            (DiagnosticStatus, "controller/status", self._take_status),
            (Log, "/rosout", self._take_log),
        ):
            node.create_subscription(kind, topic, take, _DEPTH)

    def begin(self, goal: Vector) -> GoalRun:
        """Begin a trial and return its run to a goal, shape (6,)."""
        self.run = GoalRun(goal)
        self.limits.begin()
        self.messages.clear()
        return self.run

    def reported(self, words: tuple[str, ...]) -> bool:
        """Return whether one of some words is in a message."""
        return any(word in line for line in self.messages for word in words)

    def pose(self, message: Any) -> None:
        """Take an undisturbed pose."""
        before, self.time = self.time, self._pose_time.of(stamp_from_ros(message.header.stamp))
        self._spacing = self.time - before
        if self.run is None:
            return
        try:
            self.run.observe(self.time, pose_from_ros(message))
        except InvalidStateError as error:
            self.limits.broken.append(f"the undisturbed pose is wrong: {error}")

    def _take_sent(self, message: Any) -> None:
        try:
            self.limits.sent(hold_from_trajectory(message, 0))
        except InvalidInputError as error:
            self.limits.broken.append(f"rotor_trajectory is wrong: {error}")

    def _take_delivered(self, message: Any) -> None:
        with suppress(InvalidInputError):  # reported when it was sent
            # Between two poses time is known no better than to their spacing.
            latest = self.time + self._spacing
            self.limits.delivered(hold_from_trajectory(message, 0), latest)

    def _take_command(self, message: Any) -> None:
        self.limits.command(np.array(message.data, dtype=float))

    def _take_joints(self, message: Any) -> None:
        stamp = stamp_from_ros(message.header.stamp)
        _, speeds, _ = joint_states_from_ros(message)
        self.limits.joints(stamp, speeds)
        then = self._joint_time.of(stamp)
        if np.max(np.abs(speeds)) > _AT_REST:
            self.moving_until = then

    def _take_diagnostics(self, message: Any) -> None:
        for status in message.status:
            self._take_status(status)

    def _take_status(self, message: Any) -> None:
        if message.level != DiagnosticStatus.OK or message.message == "paused":
            self.messages.append(f"{message.name}: {message.message}")
        for pair in message.values:
            self._count(f"{message.name} {pair.key}", pair.key, pair.value)

    def _count(self, place: str, key: str, text: str) -> None:
        """Add a message for a number that rose, among which those of interest are counters."""
        try:
            value = float(text)
        except ValueError:
            return
        if value > self._counters.get(place, math.inf):
            # The keys of the status have underscores, those of diagnostics have not.
            self.messages.append(f"{key.replace('_', ' ')} rose ({key})")
        self._counters[place] = value

    def _take_log(self, message: Any) -> None:
        self.messages.append(f"{message.name}: {message.msg}")
