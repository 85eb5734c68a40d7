# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The judges find each kind of wrong command, and nothing wrong with right ones."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from fuzz import FuzzJudge, faults_of_line
from hostile import FORGED
from judge import LimitCheck
from rclpy.serialization import serialize_message
from relay import (
    PoseStream,
    ahead,
    delayed,
    dropped,
    duplicated,
    framed,
    not_finite,
    scaled,
    shuffled,
    sign_flipped,
    stamp_of,
)
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import make_state
from sphere_nmpc.ros.messages import (
    clock_message,
    pose_message,
    pose_of_message,
    speeds_message,
    trajectory_message,
)

SECOND = 10**9
PERIOD = SECOND // 20
TURNED = make_state((0.0, 0.0), (0.6, 0.0, 0.8, 0.0))


def hold(*knots: tuple[float, float, float]) -> FirstOrderHold:
    """Return a hold from rows of time [s] and two speeds [rad/s]."""
    rows = np.array(knots)
    return FirstOrderHold(rows[:, 0], rows[:, 1:])


IN_FORCE = hold((0.0, 0.0, 0.0), (1.0, 50.0, 0.0))


@pytest.mark.parametrize(
    ("holds", "complaint"),
    [
        ([hold((0.0, -100.0, 0.0), (0.5, 100.0, 0.0))], None),
        ([hold((0.0, 101.0, 0.0))], "101 rad/s"),
        ([hold((0.0, 0.0, 0.0), (0.1, 0.0, 41.0))], "rad/s^2"),
        ([IN_FORCE, hold((0.5, 25.0, 0.0), (1.0, 0.0, 0.0))], None),
        ([IN_FORCE, hold((0.5, 24.5, 0.0), (1.0, 0.0, 0.0))], "0.5 rad/s away"),
    ],
)
def test_commands_beyond_a_limit_are_violations(holds, complaint) -> None:
    check = LimitCheck()
    for one in holds:
        check.trajectory(one)
    assert len(check.broken) == (complaint is not None)
    assert complaint is None or complaint in check.broken[0]


def test_command_that_is_not_finite_is_a_violation() -> None:
    check = LimitCheck()
    check.command(np.array([np.nan, 0.0]))
    assert len(check.broken) == 1


@pytest.mark.parametrize(("first", "violations"), [(24.0, 0), (50.0, 0), (52.0, 1), (18.0, 1)])
def test_command_after_a_late_one_starts_while_the_drives_catch_up(first, violations) -> None:
    check = LimitCheck()
    check.delivered(hold((0.0, 20.0, 0.0), (1.0, 20.0, 0.0)))
    late = hold((0.5, 20.0, 0.0), (0.6, 60.0, 0.0))
    for now in (0.57, 0.575):  # a copy is not another command
        check.delivered(late, now)
    check.delivered(hold((0.575, first, 0.0), (1.0, first, 0.0)))
    assert len(check.broken) == violations


@pytest.mark.parametrize(("servo_error", "extra", "violations"),
                         [(0.0, 0.0, 0), (0.0, 0.06, 1), (0.07, 0.06, 0), (0.07, 0.1, 1)])
def test_measured_speeds_may_change_by_the_error_of_a_servo_more(
    servo_error, extra, violations
) -> None:
    check = LimitCheck(servo_error)
    check.joints(0, np.zeros(2))
    check.joints(PERIOD, np.array([0.0, 20.0 + extra]))  # 400 rad/s^2 and a little
    assert len(check.broken) == violations


@pytest.fixture
def complaints() -> list[str]:
    return []


@pytest.fixture
def judge(complaints) -> FuzzJudge:
    """A judge whose true time is 5 s, since 10 s of wall time."""
    judge = FuzzJudge(lambda what, detail: complaints.append(what))
    judge.clock(clock_message(5 * SECOND), 10 * SECOND, 0)
    return judge


def command(start: float, *speeds: float, spacing: float = 0.5) -> bytes:
    times = start + spacing * np.arange(len(speeds))
    return trajectory_message(FirstOrderHold(times, np.outer(speeds, [1.0, -1.0])))


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        (command(5.4, 0.0, 100.0, 0.0), []),
        (command(5.6, 0.0, 100.0, 0.0), ["commands more than 0.5 s ahead"]),
        (command(5.0, 0.0, 100.0), ["commands that do not end at rest"]),
        (command(5.0, 0.0, 100.0, 0.0, spacing=6.0), ["commands that are too long"]),
        (command(5.0, 0.0, 101.0, 0.0), ["commands out of limits"]),
        (serialize_message(JointTrajectory()), ["commands out of limits"]),
    ],
    ids=range(6),  # padding of messages differs between the processes of a test run
)
def test_each_bad_command_has_one_complaint(judge, complaints, given, complaint) -> None:
    judge.trajectory(given, 10 * SECOND, 0)
    judge.command(speeds_message(np.array([100.0, -100.0])), 10 * SECOND, 0)
    judge.collect()
    assert complaints == complaint and judge.count == 2


def test_a_controller_has_a_second_to_notice_that_time_went_back(judge, complaints) -> None:
    judge.clock(clock_message(0), 11 * SECOND, 0)
    judge.trajectory(command(5.0, 0.0, 0.0), 12 * SECOND - 1, 0)
    assert not complaints
    judge.trajectory(command(5.0, 0.0, 0.0), 12 * SECOND, 0)
    assert complaints == ["commands more than 0.5 s ahead"]


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("[WARN] [1.0] [controller]: pose refused: given 'm\\x1b', \u00fc", []),
        ("Traceback (most recent call last):", ["tracebacks"]),
        ("x" * 501, ["long lines in a log"]),
        (FORGED, ["forged lines in a log"]),
        ("frame '\x1b[2J'", ["control characters in a log"]),
        ("a.py:1: RuntimeWarning: overflow", ["warnings of libraries in a log"]),
    ],
)
def test_each_fault_of_a_log_has_one_complaint(line, complaint) -> None:
    assert list(faults_of_line(line)) == complaint


def passed(*disturbances) -> list[tuple[int, bytes]]:
    """Return the poses that leave a stream, each with the number of its period."""
    stream = PoseStream(np.random.default_rng(1))
    stream.disturbances.extend(disturbances)
    out = []
    for number in range(220):
        pose = pose_message(TURNED, number * PERIOD, 0.3)
        left = stream.pass_on(number * PERIOD, pose, is_lost=number >= 200)
        out += [(number, one) for one in left]
    return out


def test_disturbances_change_when_poses_arrive() -> None:
    def stamps(*disturbances) -> list[int]:
        return [stamp_of(pose) // PERIOD for _, pose in passed(*disturbances)]

    everything = list(range(200))
    assert stamps() == everything and stamps(dropped(1.0)) == []
    assert 70 < len(stamps(dropped(0.5))) < 130
    assert [n - stamp_of(pose) // PERIOD for n, pose in passed(delayed(0.2))] == [4] * 200
    assert stamps(shuffled(0.15)) != sorted(stamps(shuffled(0.15))) == everything
    assert stamps(duplicated(2), duplicated(2)) == sorted(4 * everything)
    assert stamps(ahead(0.5)) == [n + 10 for n in everything]


def test_disturbances_change_what_poses_say() -> None:
    flipped = {tuple(pose_of_message(pose)) for _, pose in passed(sign_flipped())}
    assert flipped == {tuple(TURNED), (0.0, 0.0, *-TURNED[2:])}
    for disturbance in (not_finite(), scaled(2.0), framed("map")):
        for _, pose in passed(disturbance):
            with pytest.raises(InvalidStateError):
                pose_of_message(pose)
