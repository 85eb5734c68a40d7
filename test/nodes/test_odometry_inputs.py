# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Stamps and descriptions that the odometry node cannot use, and what it reports."""

from xml.etree.ElementTree import Element

import pytest
from rclpy.parameter import Parameter
from robot_at_rest import STEP, RobotAtRest, exact

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.estimation import mounting
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.reporting.conditions import ERROR, OK
from sphere_nmpc.ros.odometry.node import OdometryNode

AHEAD = 1000 * NANOSECONDS
UPRIGHT = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]


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
    robot = RobotAtRest(graph)
    robot.start(initial_state=UPRIGHT)
    robot.stay(4.0, imu, joints)
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
    robot = RobotAtRest(graph)
    robot.start(initial_state=UPRIGHT)
    robot.stay(3.0, imu, joints)
    level, message = robot.status
    assert level == ERROR and message.startswith(told), message
    assert bool(robot.poses) == (imu is exact)  # encoders are not needed for a pose


@pytest.mark.parametrize(
    ("imu", "joints", "told"),
    [(bunches, exact, "readings of the IMU"), (exact, bunches, "rotor speeds")],
)
def test_stamps_of_bunches_are_told_before_the_calibration_that_waits_for_better_ones(
    graph, imu, joints, told
) -> None:
    robot = RobotAtRest(graph)
    robot.start(initial_state=UPRIGHT)
    robot.stay(3.0, imu, joints)
    message = robot.status[1]
    assert message.startswith("inexact stamps: given") and f"% of the {told} less than" in message


def test_description_is_read_once_at_the_start_and_one_that_is_none_is_no_start(
    graph, monkeypatch
) -> None:
    read: list[str] = []
    parse = mounting.ElementTree.fromstring

    def counted(text: str) -> Element:
        read.append(text)
        return parse(text)

    monkeypatch.setattr(mounting.ElementTree, "fromstring", counted)
    with pytest.raises(InvalidParameterError, match=r"robot_description: given 'robot\.urdf'"):
        OdometryNode([Parameter("robot_description", value="robot.urdf")])
    robot = RobotAtRest(graph)
    robot.start(robot_description='<robot name="sphere"><link name="base_link"/></robot>')
    robot.stay(0.5)
    assert len(read) == 2
    assert len(robot.refused) == 50 and robot.refused[0].startswith("frame: given 'imu'")
