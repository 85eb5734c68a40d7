# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands within the limits, which of them are followed, and poses that are late or lost."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphere_nmpc.control.link import Link
from sphere_nmpc.control.sending import REACH, Commands
from sphere_nmpc.estimation.rotor_history import RotorHistory
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters

ROBOT = RobotParameters()
PERIOD = 0.25
EXACT = 1e-12
LIMIT = 1000.0
"""Limit of the rotors' acceleration of the class `Robot` [rad/s^2]."""


@pytest.mark.parametrize(("period", "reach"), [(0.002, REACH), (PERIOD, REACH), (2.5, 5.0)])
def test_command_of_a_long_plan_is_at_rest_soon_after_it_should_have_been_renewed(
    period: float, reach: float
) -> None:
    speeds = np.array([[0.0, 0.0], [100.0, 100.0], [100.0, 100.0]])
    plan = FirstOrderHold(np.array([0.0, 0.25, 2000.0]), speeds)
    sent = Commands(ROBOT, print).joined(plan, 0.0, period)
    np.testing.assert_array_equal(sent.speeds[-1], 0.0)
    assert sent.end == pytest.approx(reach + 100.0 / ROBOT.max_rotor_acceleration)
    for time in (0.1, 0.25, 1.0, reach):
        np.testing.assert_array_equal(sent.at(time), plan.at(time))


@given(
    start=st.floats(0.0, 1.9), count=st.integers(3, 60), spacing=st.floats(1e-3, 0.1),
    epoch=st.sampled_from([0.0, 12345.678]),
)
def test_accelerations_by_the_stamps_keep_the_limit(
    start: float, count: int, spacing: float, epoch: float
) -> None:
    limit, commands = ROBOT.max_rotor_acceleration, Commands(ROBOT, print)
    commands.rotors.record(FirstOrderHold.constant(epoch, np.array([100.0, 3e-7])))
    # Between the limits of speed, with steps as large as those of acceleration.
    speeds = 100.0 - np.abs(limit * spacing * np.arange(1, count + 1) % 400.0 - 200.0)
    plan = FirstOrderHold(spacing * np.arange(count), np.column_stack((speeds, -speeds)))
    near = spacing * round(start / spacing) - 4e-9  # just before a knot
    for at in (start, near):
        sent = commands.joined(plan.delayed(epoch), epoch + at, PERIOD)
        intervals = np.diff(np.rint(sent.times * 1e9)) * 1e-9
        assert np.all(intervals >= 0.999e-6)
        slopes = np.abs(np.diff(sent.speeds, axis=0)) / intervals[:, None]
        assert np.max(slopes) <= limit * (1.0 + 1e-9)  # rounding of the quotient alone


def test_command_after_a_step_back_of_the_clock_begins_now_or_soon() -> None:
    commands = Commands(ROBOT, print)
    commands.rotors.record(FirstOrderHold.constant(100.0, np.zeros(2)))
    assert commands.earliest(99.9) == 100.0
    assert commands.earliest(99.4) == 99.4
    assert commands.earliest(100.1) == 100.1


class Robot:
    """Rotors that follow the holds which arrive, without limits, and what is sent to them."""

    def __init__(self) -> None:
        self.rotors = RotorHistory(LIMIT)
        self.rotors.judge(1e9, 0.0, 25.0)  # measured speeds explain the motion
        self.link = Link(self.rotors)
        self.newest = self.arrived = FirstOrderHold.constant(0.0, np.zeros(2))

    def send(self, start: float, first: float, slope: float, arrives: bool = False) -> None:
        """Send a ramp of ten seconds [rad/s, rad/s^2] of rotor 1, the other one at rest."""
        self.newest = FirstOrderHold(
            np.array([start, start + 10.0]), np.array([[first, 0.0], [first + 10.0 * slope, 0.0]])
        )
        self.rotors.record(self.newest)
        if arrives:
            self.arrive()

    def arrive(self) -> None:
        """Follow the newest hold from now on."""
        self.arrived = self.newest

    def measure(self, *times: float) -> None:
        for time in times:
            self.rotors.observe(time, self.arrived.at(time))

    def believed(self, *times: float) -> list[float]:
        return [float(self.rotors.at(time)[0]) for time in times]


@pytest.fixture
def robot() -> Robot:
    return Robot()


def test_lost_command_was_never_followed(robot) -> None:
    robot.send(1.0, 0.0, 10.0, arrives=True)
    robot.measure(1.2)
    assert robot.believed(0.9, 1.2, 5.0) == pytest.approx([0.0, 2.0, 40.0], abs=EXACT)
    assert robot.link.window == 0.0 and robot.link.loss == 0.0
    robot.send(2.0, 10.0, -10.0)
    robot.measure(2.1, 2.2)
    assert robot.believed(1.5, 2.2, 3.0) == pytest.approx([5.0, 12.0, 20.0], abs=EXACT)
    robot.send(2.5, 15.0, 0.0, arrives=True)
    robot.measure(2.7)
    assert robot.believed(2.2, 2.7) == pytest.approx([12.0, 15.0], abs=EXACT)
    assert robot.link.loss == pytest.approx(1 / 3) and robot.link.is_apparent


def test_late_command_is_followed_from_when_it_was_measured(robot) -> None:
    robot.send(1.0, 0.0, 10.0, arrives=True)
    robot.measure(1.9)
    robot.send(2.0, 10.0, -10.0)
    robot.measure(2.06, 2.1)
    robot.arrive()
    robot.measure(2.14)
    began = 2.14 - (11.4 - 8.6) / LIMIT
    assert robot.believed(2.1, began) == pytest.approx([11.0, 10.0 * (began - 1.0)], abs=1e-9)
    assert robot.believed(2.14, 3.0) == pytest.approx([8.6, 0.0], abs=EXACT)
    assert robot.rotors.delay == pytest.approx(began - 2.0)
    assert robot.link.window == pytest.approx(began - 2.0)


@pytest.mark.parametrize(
    ("late", "slope", "window", "expected"),
    [(0.03, 1.0, 0.03, [0.0, 0.0, 30.0, 170.0]), (0.0, 0.6, 0.0, [20.0, 30.0, 60.0, 200.0])],
    ids=["late", "weak"],
)
def test_rotors_that_catch_up_as_fast_as_they_can_are_late_and_slower_ones_weak(
    robot, late, slope, window, expected
) -> None:
    robot.send(1.0, 0.0, LIMIT)
    for time in (1.05, 1.07, 1.09):
        robot.rotors.observe(time, np.array([slope * LIMIT * (time - 1.0 - late), 0.0]))
    assert robot.believed(1.02, 1.03, 1.06, 1.2) == pytest.approx(expected, abs=1e-6)
    assert robot.link.window == pytest.approx(window)


def test_window_is_limited_and_shrinks_while_commands_are_in_time(robot) -> None:
    robot.send(1.0, 0.0, 10.0)
    robot.measure(1.5)
    robot.arrive()
    robot.measure(1.9)
    assert robot.link.window == pytest.approx(0.3), "rather than 0.9"
    for i in range(400):
        start = 2.0 + 0.1 * i
        robot.send(start, 20.0 * (i % 2), 0.0, arrives=True)
        robot.measure(start + 0.05)
    assert robot.link.window == 0.0
    assert not robot.link.needs_speeds


def test_delay_and_loss_of_poses_follow_from_their_stamps() -> None:
    link = Link(RotorHistory())
    assert math.isnan(link.pose_delay) and math.isnan(link.pose_loss)
    link.pose_received(0.0, 0.02)
    for i in range(1, 101):
        if i % 5 != 3:
            link.pose_received(0.02 * i, math.nan if i % 2 else 0.02 + 0.02 * (i == 50))
            link.pose_received(max(0.02 * i - 0.01, 1e-3), 9.0)  # overtaken
    assert link.pose_delay == pytest.approx(0.02 + 0.02 / 41)
    assert link.pose_loss == pytest.approx(20 / 100)
    for time in (0.0, 0.1, 0.2):  # the clock has jumped back
        link.pose_received(time, 0.0)
    assert link.pose_loss == 0.0 and link.pose_delay == 0.0
