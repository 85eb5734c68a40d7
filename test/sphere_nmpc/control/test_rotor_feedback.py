# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Measured rotor speeds tell which commands are followed, with plain numbers."""

import numpy as np
import pytest

from sphere_nmpc.control.rotor_feedback import RotorFeedback
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.model.first_order_hold import FirstOrderHold

EXACT = 1e-12
LIMIT = 1000.0
"""Limit of the rotors' acceleration [rad/s^2]."""


class Robot:
    """Rotors that follow the holds which arrive, without limits, and what is sent to them."""

    def __init__(self) -> None:
        self.sent = SentInputs()
        self.feedback = RotorFeedback(self.sent, LIMIT)
        self.arrived: FirstOrderHold | None = None

    def send(self, start: float, first: float, slope: float, arrives: bool = False) -> None:
        """Send a ramp of ten seconds [rad/s, rad/s^2] of rotor 1, the other one at rest."""
        hold = FirstOrderHold(
            np.array([start, start + 10.0]), np.array([[first, 0.0], [first + 10.0 * slope, 0.0]])
        )
        self.sent.record(hold)
        self.feedback.sent(hold)
        self.newest = hold
        if arrives:
            self.arrive()

    def arrive(self) -> None:
        """Follow the newest hold from now on."""
        self.arrived = self.newest

    def measure(self, *times: float, lag: float = 0.0) -> None:
        for time in times:
            self.feedback.observe(time, self.speeds(time - lag), lag)

    def speeds(self, time: float) -> np.ndarray:
        return np.zeros(2) if self.arrived is None else self.arrived.at(time)

    def believed(self, *times: float) -> list[float]:
        return [float(self.sent.at(time)[0]) for time in times]


def test_command_in_time_changes_nothing() -> None:
    robot = Robot()
    robot.send(1.0, 0.0, 10.0, arrives=True)
    robot.measure(1.0, 1.2, 1.4)
    assert robot.believed(0.9, 1.2, 5.0) == pytest.approx([0.0, 2.0, 40.0], abs=EXACT)
    assert robot.feedback.window == 0.0 and robot.feedback.loss == 0.0


def test_lost_command_was_never_followed() -> None:
    robot = Robot()
    robot.send(1.0, 0.0, 10.0, arrives=True)
    robot.measure(1.2)
    robot.send(2.0, 10.0, -10.0)
    robot.measure(2.1, 2.2)
    assert robot.believed(1.5, 2.2, 3.0) == pytest.approx([5.0, 12.0, 20.0], abs=EXACT)
    robot.send(2.5, 15.0, 0.0, arrives=True)
    robot.measure(2.7)
    assert robot.believed(2.2, 2.7) == pytest.approx([12.0, 15.0], abs=EXACT)
    assert robot.feedback.loss > 0.0


def test_late_command_is_followed_from_when_it_was_measured() -> None:
    robot = Robot()
    robot.send(1.0, 0.0, 10.0, arrives=True)
    robot.measure(1.9)
    robot.send(2.0, 10.0, -10.0)
    robot.measure(2.06, 2.1)
    robot.arrive()
    robot.measure(2.14)
    began = 2.14 - (11.4 - 8.6) / LIMIT
    assert robot.believed(2.1, began) == pytest.approx([11.0, 10.0 * (began - 1.0)], abs=1e-9)
    assert robot.believed(2.14, 3.0) == pytest.approx([8.6, 0.0], abs=EXACT)
    assert robot.feedback.delay == pytest.approx(began - 2.0)
    assert robot.feedback.window == pytest.approx(began - 2.0)


def test_rotors_that_catch_up_as_fast_as_they_can_follow_a_late_command() -> None:
    robot = Robot()
    robot.send(1.0, 0.0, LIMIT)
    for time in (1.05, 1.07):
        robot.feedback.observe(time, np.array([LIMIT * (time - 1.03), 0.0]))
    believed = robot.believed(1.02, 1.03, 1.06, 1.2)
    assert believed == pytest.approx([0.0, 0.0, 0.03 * LIMIT, 0.17 * LIMIT], abs=1e-6)
    assert robot.feedback.window == pytest.approx(0.03)


def test_rotors_that_do_not_attain_the_acceleration_are_weak_and_not_late() -> None:
    robot = Robot()
    robot.send(1.0, 0.0, LIMIT)
    for time in (1.05, 1.07, 1.09):
        robot.feedback.observe(time, np.array([0.6 * LIMIT * (time - 1.0), 0.0]))
    assert robot.believed(1.05, 1.2) == pytest.approx([0.05 * LIMIT, 0.2 * LIMIT])
    assert robot.feedback.window == 0.0


def test_measurement_between_two_commands_decides_nothing() -> None:
    robot = Robot()
    robot.send(1.0, 0.0, 100.0)
    robot.feedback.observe(1.2, np.array([10.0, 0.0]))
    assert robot.believed(1.2) == pytest.approx([20.0], abs=EXACT)


def test_speeds_behind_by_the_lag_are_in_time() -> None:
    robot = Robot()
    robot.send(1.0, 0.0, 100.0, arrives=True)
    robot.measure(1.03, 1.06, lag=0.02)
    assert robot.believed(1.03) == pytest.approx([3.0], abs=EXACT)
    assert robot.feedback.window == 0.0


def test_command_sent_for_later_stays_where_an_earlier_one_is_withdrawn() -> None:
    robot = Robot()
    robot.send(1.0, 0.0, 10.0)
    robot.send(3.0, 7.0, 0.0)
    robot.measure(1.5)
    assert robot.believed(1.5, 3.5) == pytest.approx([0.0, 7.0], abs=EXACT)


def test_window_is_limited_and_shrinks_while_commands_are_in_time() -> None:
    robot = Robot()
    robot.send(1.0, 0.0, 10.0)
    robot.measure(1.5)
    robot.arrive()
    robot.measure(1.9)
    window = robot.feedback.window
    assert window == pytest.approx(0.3), "rather than 0.9"
    for i in range(400):
        start = 2.0 + 0.1 * i
        robot.send(start, 20.0 * (i % 2), 0.0, arrives=True)
        robot.measure(start + 0.05)
    assert robot.feedback.window == 0.0
    assert not robot.feedback.is_needed


def test_command_that_is_late_by_less_than_the_spacing_of_measurements_is_in_time() -> None:
    """As from a controller whose clock has that spacing, too."""
    robot = Robot()
    robot.measure(0.80, 0.85, 0.90, 0.95)
    robot.send(1.0, 0.0, 100.0)
    robot.measure(1.0, 1.05)
    assert robot.believed(1.05) == pytest.approx([5.0], abs=EXACT), "not withdrawn"
    robot.arrive()
    robot.measure(1.1)
    assert robot.believed(1.05, 1.1) == pytest.approx([5.0, 10.0], abs=EXACT)
    assert robot.feedback.window == 0.0


def test_late_command_that_servos_follow_with_a_lag_is_in_force_as_it_was_sent() -> None:
    robot = Robot()
    robot.send(1.0, 0.0, LIMIT)
    robot.measure(1.1)
    robot.arrive()
    for time in (1.2, 1.3):
        robot.feedback.observe(time, robot.speeds(time - 3.3e-3), 0.0)
    assert robot.believed(1.25, 1.5) == pytest.approx([250.0, 500.0], abs=EXACT)


def test_measured_speeds_are_needed_until_commands_were_in_time_for_long() -> None:
    robot = Robot()
    for i in range(10):
        assert robot.feedback.is_needed
        robot.send(1.0 + i, 20.0 * (1 + i % 2), 0.0, arrives=True)
        robot.measure(1.5 + i)
    assert not robot.feedback.is_needed
    robot.feedback.resume()
    assert robot.feedback.is_needed


def test_after_a_jump_of_the_clock_earlier_times_count() -> None:
    robot = Robot()
    robot.send(7.0, 0.0, 10.0, arrives=True)
    robot.measure(7.5)
    robot.sent.clear()
    robot.feedback.reset()
    robot.arrived = None
    robot.send(1.0, 0.0, 10.0)
    robot.measure(1.5)
    assert robot.believed(1.5) == pytest.approx([0.0], abs=EXACT)
