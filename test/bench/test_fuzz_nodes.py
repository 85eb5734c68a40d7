# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Judge and hostile values of bench/fuzz_nodes.py."""

import random

import numpy as np
import pytest

pytest.importorskip("rclpy")

from fuzz_judge import Judge, restamped
from fuzz_session import _faults_of
from fuzz_values import FORGED, damaged, example, extreme, parameter_value
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rcl_interfaces.msg import ParameterValue
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import make_state
from sphere_nmpc.ros.messages import (
    clock_message,
    joint_states_message,
    pose_message,
    speeds_message,
    stamp_from_ros,
    trajectory_message,
)

SECOND = 10**9
REST = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))


@pytest.fixture
def complaints() -> list[str]:
    return []


@pytest.fixture
def judge(complaints) -> Judge:
    """A judge whose true time is 5 s, since 10 s of wall time."""
    judge = Judge(lambda what, detail: complaints.append(what))
    judge.clock(clock_message(5 * SECOND), 10 * SECOND, 0)
    return judge


def command(start: float, *speeds: float, spacing: float = 0.5) -> bytes:
    knots = np.array(speeds)
    return trajectory_message(FirstOrderHold(
        start + spacing * np.arange(knots.size), np.column_stack((knots, -knots))
    ))


def test_a_command_within_all_limits_has_no_complaint(judge, complaints) -> None:
    judge.trajectory(command(5.4, 0.0, 100.0, 0.0), 10 * SECOND, 0)
    judge.command(speeds_message(np.array([100.0, -100.0])), 10 * SECOND, 0)
    assert not complaints and judge.count == 2


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        (command(5.6, 0.0, 100.0, 0.0), "commands more than 0.5 s ahead"),
        (command(5.0, 0.0, 100.0), "commands that do not end at rest"),
        (command(5.0, 0.0, 100.0, 0.0, spacing=6.0), "commands that are too long"),
        (command(5.0, 0.0, 101.0, 0.0), "commands out of limits"),
        (command(5.0, 0.0, 100.0, 0.0, spacing=0.2), "commands out of limits"),
        (serialize_message(JointTrajectory()), "commands out of limits"),
    ],
    ids=range(6),  # padding of messages differs between the processes of a test run
)
def test_each_bad_command_has_one_complaint(judge, complaints, given, complaint) -> None:
    judge.trajectory(given, 10 * SECOND, 0)
    assert complaints == [complaint]


def test_a_command_is_judged_by_the_time_before_it_on_the_shifted_clock(judge, complaints) -> None:
    judge.clock(clock_message(6 * SECOND), 11 * SECOND, 60 * SECOND)
    judge.trajectory(command(66.0, 0.0, 0.0), 11 * SECOND, 60 * SECOND)
    assert not complaints
    judge.trajectory(command(66.0, 0.0, 0.0), 11 * SECOND - 1, 60 * SECOND)  # before the jump
    assert complaints == ["commands more than 0.5 s ahead"]


def test_a_controller_has_a_second_to_notice_that_time_went_back(judge, complaints) -> None:
    judge.clock(clock_message(0), 11 * SECOND, 0)
    judge.trajectory(command(5.0, 0.0, 0.0), 12 * SECOND - 1, 0)
    assert not complaints
    judge.trajectory(command(5.0, 0.0, 0.0), 12 * SECOND, 0)
    assert complaints == ["commands more than 0.5 s ahead"]


def test_measured_rotors_are_judged_unless_they_may_be_reset(judge, complaints) -> None:
    for stamp, speed in ((0, 0.0), (SECOND // 10, 40.0), (SECOND // 5, 81.0)):
        state = joint_states_message(np.zeros(2), np.array([speed, 0.0]), np.zeros(2), stamp)
        judge.joints(state, stamp, 0)
    assert complaints == ["commands out of limits"] and judge.turning == 81.0
    judge.reset_until = float("inf")
    judge.joints(
        joint_states_message(np.zeros(2), np.zeros(2), np.zeros(2), SECOND // 4), SECOND, 0
    )
    assert len(complaints) == 1


def test_rotors_follow_a_command_in_motion_only(judge) -> None:
    judge.trajectory(command(5.0, 0.0, 100.0, 0.0), 10 * SECOND, 0)
    for speed, follows in ((50.0, True), (0.0, False)):
        stamp = 5 * SECOND + SECOND // 4
        speeds = np.array([speed, -speed])
        judge.joints(joint_states_message(np.zeros(2), speeds, np.zeros(2), stamp), 0, 0)
        assert judge.follows(0.0) is follows


def test_a_late_pose_is_ignored_until_the_simulator_is_restarted(judge) -> None:
    for stamp, x, expected in ((2, 1.0, 1.0), (1, 5.0, 1.0), (2, 3.0, 3.0)):
        judge.pose(pose_message(make_state((x, 0.0), REST[2:]), stamp, 0.3), 0, 0)
        assert judge.state[0] == expected
    judge.restarted()
    judge.pose(pose_message(REST, 0, 0.3), 0, 0)
    assert judge.state[0] == 0.0


@pytest.mark.parametrize("shift", [0, 1, -5 * SECOND, 10**18])
def test_a_stamp_can_be_shifted_to_before_zero(shift) -> None:
    clock = deserialize_message(restamped(clock_message(SECOND), shift), Clock)
    assert stamp_from_ros(clock.clock) == SECOND + shift


@pytest.mark.parametrize("kind", [PoseStamped, Path, JointState, JointTrajectory])
def test_a_seed_repeats_damaged_and_extreme_messages(kind) -> None:
    valid = example(kind)
    drawn = []
    for _ in range(2):
        rng = random.Random(1)
        damage = [damaged(rng, valid) for _ in range(50)]
        messages = [deserialize_message(extreme(rng, kind, valid), kind) for _ in range(20)]
        drawn.append((damage, list(map(repr, messages))))  # the padding of messages may differ
    assert drawn[0] == drawn[1]
    assert len(set(drawn[0][0])) > 10 and len(set(drawn[0][1])) > 5


def test_parameters_are_given_values_of_every_type_and_of_unknown_ones() -> None:
    rng = random.Random(1)
    values = [parameter_value(rng, ParameterValue(type=3, double_value=1.0)) for _ in range(2000)]
    assert {*range(11), 99, 255} <= {value.type for value in values}
    for value in values:
        serialize_message(value)


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("Traceback (most recent call last):", "tracebacks"),
        ("x" * 501, "long lines in a log"),
        (FORGED, "forged lines in a log"),
        ("frame '\x1b[2J'", "control characters in a log"),
        ("a.py:1: RuntimeWarning: overflow", "warnings of libraries in a log"),
    ],
)
def test_each_fault_of_a_log_has_one_complaint(line, complaint) -> None:
    assert list(_faults_of(line)) == [complaint]
    assert not list(_faults_of("[WARN] [1.0] [controller]: pose refused: given 'm\\x1b', \u00fc"))
