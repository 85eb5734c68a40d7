# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Stamps of readings and rotor speeds that the odometry node cannot use, and what it reports."""

from collections.abc import Callable

import numpy as np
import pytest
from ros_graph import Graph

from sphere_nmpc.conditions import ERROR, OK, Severity
from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.ros.cdr import clock_message, imu_message, joint_states_message
from sphere_nmpc.ros.odometry.node import OdometryNode

STEP = NANOSECONDS // 100
AHEAD = 1000 * NANOSECONDS
STILL = np.zeros(2)
Stamp = Callable[[int, int], int]


class Robot:
    """An odometry node in simulated time, served with what a robot at rest sends at 100 Hz."""

    def __init__(self, graph: Graph) -> None:
        self.node = graph.start(OdometryNode, use_sim_time=True)
        self._random = np.random.default_rng(0)
        self._sent = 0
        self.refused: list[str] = []
        self.poses: list[int] = []
        """Stamps of the poses [ns]."""
        publish = self.node._publish

        def count() -> None:
            before, self.node._sent = self.node._sent, []
            publish()
            self.poses += [self.node._sent_stamp] if self.node._sent else []
            self.node._sent = self.node._sent or before

        self.node._publish = count

    def rest(self, duration: float, imu: Stamp, joints: Stamp) -> None:
        """Be at rest for a time [s]; the stamps are functions of number and time [ns]."""
        for _ in range(round(100 * duration)):
            self._sent += 1
            now = self._sent * STEP
            noise = self._random.normal(size=(2, 3)) * [[1e-3], [1e-2]]
            self.node._control_clock.hear(clock_message(now))
            self._give(self.node._receive_imu, imu_message(
                noise[0], noise[1] + [0.0, 0.0, 9.81], np.array([1e-3, 1e-2]),
                imu(self._sent, now), "imu",
            ))
            self._give(self.node._receive_joints, joint_states_message(
                STILL, STILL, STILL, joints(self._sent, now)
            ))
            if self._sent % 25 == 0:
                self.node._check()

    def _give(self, receive: Callable[[bytes], None], message: bytes) -> None:
        try:
            receive(message)
        except InvalidInputError as error:
            self.refused.append(str(error))

    @property
    def status(self) -> tuple[Severity, str]:
        level, message, _ = self.node._reports._last
        return level, message


def exact(number: int, now: int) -> int:
    return now


def once(number: int, now: int) -> int:
    return now + (AHEAD if number in (1, 150) else 0)


def of_gps(number: int, now: int) -> int:
    return now + 18 * NANOSECONDS


def unset(number: int, now: int) -> int:
    return 0


def bunches(number: int, now: int) -> int:
    return number // 10 * 10 * STEP + number % 10 * (STEP // 100)


@pytest.mark.parametrize(("imu", "joints"), [(once, exact), (exact, once), (once, once)])
def test_stamps_ahead_are_refused_with_their_offset_and_the_others_are_used(
    graph, imu, joints
) -> None:
    robot = Robot(graph)
    robot.rest(4.0, imu, joints)
    level, message = robot.status
    assert (level, message) == (OK, "estimating")
    assert robot.poses[-1] == 400 * STEP and len(robot.poses) > 150
    assert len(robot.refused) == 2 * [imu, joints].count(once)
    for line in robot.refused:
        assert line.startswith("stamp: given 1000 s ahead of this node's clock, expected at most")


@pytest.mark.parametrize(
    ("imu", "joints", "told"),
    [
        (of_gps, of_gps, "wrong clock: given readings of the IMU on /imu with stamps 18 s ahead"),
        (of_gps, exact, "wrong clock: given readings of the IMU on /imu with stamps 18 s ahead"),
        (exact, of_gps, "wrong clock: given rotor speeds on /joint_states with stamps 18 s ahead"),
        (exact, unset, "no stamp: given rotor speeds on /joint_states with the stamp 0"),
    ],
)
def test_topic_whose_stamps_are_all_of_another_clock_is_named(graph, imu, joints, told) -> None:
    robot = Robot(graph)
    robot.rest(3.0, imu, joints)
    level, message = robot.status
    assert level == ERROR and message.startswith(told), message
    assert not robot.poses


@pytest.mark.parametrize(
    ("imu", "joints", "told"),
    [(bunches, exact, "readings of the IMU"), (exact, bunches, "rotor speeds")],
)
def test_stamps_of_bunches_are_told_before_the_calibration_that_waits_for_better_ones(
    graph, imu, joints, told
) -> None:
    robot = Robot(graph)
    robot.rest(3.0, imu, joints)
    message = robot.status[1]
    assert message.startswith("inexact stamps: given") and f"% of the {told} less than" in message
