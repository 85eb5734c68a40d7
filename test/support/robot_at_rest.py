# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""An odometry node in simulated time, served without DDS with what a robot sends."""

from collections.abc import Callable

import numpy as np
from ros_graph import Graph

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.reporting.conditions import Severity
from sphere_nmpc.ros.cdr_messages import clock_message, imu_message, joint_states_message
from sphere_nmpc.ros.odometry.node import OdometryNode

STEP = NANOSECONDS // 100
"""Time between two readings [ns]."""
Stamp = Callable[[int, int], int]
"""Stamp of a message [ns] by its number and the time [ns]."""


def exact(number: int, now: int) -> int:
    return now


class RobotAtRest:
    """A robot whose IMU and encoders are read at 100 Hz, and an odometry node, which may restart.

    Times are those of the node's clock, which begins at 0.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._random = np.random.default_rng(0)
        self.now = 0
        """Time [ns]."""
        self.gravity: Vector = np.array([0.0, 0.0, 9.81])
        """Specific force at rest [m/s^2], in the axes of the IMU."""
        self.rate: Vector = np.zeros(3)
        """Angular velocity of the shell [rad/s]."""
        self.angles: Vector = np.array([1.0, -2.0])
        """Angles of the rotors [rad]."""
        self.refused: list[str] = []
        self.poses: list[int] = []
        """Stamps of the poses [ns]."""
        self.node: OdometryNode | None = None

    def start(self, **parameters: object) -> OdometryNode:
        """Start the node, or start it again after it was killed."""
        if self.node is not None:
            self._graph.remove(self.node)
        self.node = self._graph.start(OdometryNode, use_sim_time=True, **parameters)
        messages = self.node._publisher.messages

        def counted(poses, *more):
            self.poses += [stamp for stamp, _ in poses]
            return messages(poses, *more)

        self.node._publisher.messages = counted
        return self.node

    def stay(self, duration: float, imu: Stamp = exact, joints: Stamp = exact) -> None:
        """Let a time pass [s]."""
        for _ in range(round(100 * duration)):
            self.node._control_clock.hear(clock_message(self.now + STEP))
            self.send(imu, joints)
            if self.now // STEP % 25 == 0:
                self.node._check()

    def send(self, imu: Stamp = exact, joints: Stamp = exact) -> None:
        """Send what is measured next."""
        self.now += STEP
        number = self.now // STEP
        noise = self._random.normal(size=(2, 3)) * [[1e-3], [1e-2]]
        self._give(self.node._receive_imu, imu_message(
            noise[0] + self.rate, noise[1] + self.gravity, np.array([1e-3, 1e-2]),
            imu(number, self.now), "imu",
        ))
        self._give(self.node._receive_joints, joint_states_message(
            self.angles, np.zeros(2), np.zeros(2), joints(number, self.now)
        ))

    def _give(self, receive: Callable[[bytes], None], message: bytes) -> None:
        try:
            receive(message)
        except InvalidInputError as error:
            self.refused.append(str(error))

    @property
    def status(self) -> tuple[Severity, str]:
        """Level and message of the newest status."""
        level, message, _ = self.node._reports.report
        return level, message
