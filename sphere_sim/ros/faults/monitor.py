# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Listens to everything and judges it, independently of the nodes that are on trial."""

import math
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
from sphere_nmpc.model.state import Vector, state_error
from sphere_nmpc.ros.conversions import (
    NANOSECONDS,
    hold_from_trajectory,
    joint_states_from_ros,
    pose_from_ros,
    stamp_from_ros,
)
from sphere_sim.faults.limits import LimitCheck

_DEPTH = 1000
_AT_REST = 1e-3
"""Speed below which a rotor rests [rad/s]."""
_SETTLED = 1e-2
"""Error below which the goal is reached [mixed units]."""


class RunningTime:
    """Time that goes on where stamps start anew with a new simulator."""

    def __init__(self) -> None:
        self._before = self._last = 0

    def of(self, stamp: int) -> float:
        """Return the running time [s] of a stamp [ns]."""
        if stamp < self._last - NANOSECONDS:
            self._before += self._last
        self._last = stamp
        return (self._before + stamp) / NANOSECONDS


class FaultMonitor:
    """Watch limits, progress towards the goal, and what the nodes say.

    Parameters
    ----------
    node : Node
        Owner of the subscriptions.
    robot : RobotParameters
        For the limits.
    """

    def __init__(self, node: Node, robot: RobotParameters) -> None:
        self.limits = LimitCheck(robot.max_rotor_speed, robot.max_rotor_acceleration)
        self.goal: Vector | None = None
        """What the true pose is compared with, shape (6,)."""
        self.time = 0.0
        """Simulated time since the start, which goes on when the simulator starts anew [s]."""
        self.error = math.nan
        """Distance to the goal."""
        self.inside_since: float | None = None
        """Since when the error has been small [s]; None while it is not."""
        self.moving_until = 0.0
        """When a rotor last turned [s]."""
        self.said: list[str] = []
        """Log lines, messages of diagnostics and names of counters that rose."""
        self._pose_time, self._joint_time = RunningTime(), RunningTime()
        self._counters: dict[str, float] = {}
        for kind, topic, take in (
            (JointTrajectory, "rotor_trajectory", self._take_trajectory),
            (Float64MultiArray, "rotor_commands", self._take_command),
            (JointState, "joint_states", self._take_joints),
            (DiagnosticArray, "/diagnostics", self._take_diagnostics),
            (DiagnosticStatus, "controller/status", self._take_status),
            (Log, "/rosout", self._take_log),
        ):
            node.create_subscription(kind, topic, take, _DEPTH)

    def begin(self, goal: Vector) -> None:
        """Judge anew, on the way to a goal of shape (6,)."""
        self.goal, self.inside_since, self.error = goal, None, math.nan
        self.limits.begin()
        self.said.clear()

    def heard(self, words: tuple[str, ...]) -> bool:
        """Return whether one of some words was said."""
        return any(word in line for line in self.said for word in words)

    def pose(self, message: Any) -> None:
        """Take note of the true pose."""
        self.time = self._pose_time.of(stamp_from_ros(message.header.stamp))
        if self.goal is None:
            return
        try:
            self.error = state_error(pose_from_ros(message), self.goal)
        except InvalidStateError as error:
            self.limits.broken.append(f"the true pose is wrong: {error}")
            return
        if not self.error < _SETTLED:
            self.inside_since = None
        elif self.inside_since is None:
            self.inside_since = self.time

    def _take_trajectory(self, message: Any) -> None:
        try:
            self.limits.trajectory(hold_from_trajectory(message, 0))
        except InvalidInputError as error:
            self.limits.broken.append(f"rotor_trajectory is wrong: {error}")

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
            self.said.append(f"{message.name}: {message.message}")
        for pair in message.values:
            self._count(f"{message.name} {pair.key}", pair.key, pair.value)

    def _count(self, place: str, key: str, text: str) -> None:
        """Note a counter that rose; other numbers rise too, and nobody asks for their words."""
        try:
            value = float(text)
        except ValueError:
            return
        if value > self._counters.get(place, math.inf):
            # The status writes words with underscores, the log without.
            self.said.append(f"{key.replace('_', ' ')} rose ({key})")
        self._counters[place] = value

    def _take_log(self, message: Any) -> None:
        self.said.append(f"{message.name}: {message.msg}")
