# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is sent: within the limits, also by its stamps, and at rest soon without a next command."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphere_nmpc.control.commands import REACH, Commands
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters

ROBOT = RobotParameters()
LIMIT = ROBOT.max_rotor_acceleration
PERIOD = 0.25


def knots(count: int, spacing: float) -> FirstOrderHold:
    """Return a hold between the limits of speed, with steps as large as those of acceleration."""
    turn = np.cumsum(np.full(count, LIMIT * spacing))
    speeds = 100.0 - np.abs(turn % 400.0 - 200.0)
    return FirstOrderHold(spacing * np.arange(count), np.column_stack((speeds, -speeds)))


@pytest.mark.parametrize(("period", "reach"), [(0.002, REACH), (PERIOD, REACH), (2.5, 5.0)])
def test_command_of_a_long_plan_is_at_rest_soon_after_it_should_have_been_renewed(
    period: float, reach: float
) -> None:
    speeds = np.array([[0.0, 0.0], [100.0, 100.0], [100.0, 100.0]])
    plan = FirstOrderHold(np.array([0.0, 0.25, 2000.0]), speeds)
    sent = Commands(ROBOT).joined(plan, 0.0, period)
    np.testing.assert_array_equal(sent.speeds[-1], 0.0)
    assert sent.end == pytest.approx(reach + 100.0 / LIMIT)
    for time in (0.1, 0.25, 1.0, reach):
        np.testing.assert_array_equal(sent.at(time), plan.at(time))


def test_command_of_a_short_plan_is_the_plan() -> None:
    plan = FirstOrderHold(np.array([0.0, 0.25, 0.5]), np.array([[0, 0], [50, 80], [0, 0]]))
    sent = Commands(ROBOT).joined(plan, 0.0, PERIOD)
    np.testing.assert_array_equal(sent.times, plan.times)
    np.testing.assert_array_equal(sent.speeds, plan.speeds)


@given(
    start=st.floats(0.0, 1.9), count=st.integers(3, 60), spacing=st.floats(1e-3, 0.1),
    epoch=st.sampled_from([0.0, 12345.678]),
)
def test_accelerations_by_the_stamps_keep_the_limit(
    start: float, count: int, spacing: float, epoch: float
) -> None:
    commands = Commands(ROBOT)
    commands.sent.record(FirstOrderHold.constant(epoch, np.array([100.0, 3e-7])))
    plan = knots(count, spacing)
    near = spacing * round(start / spacing) - 4e-9  # just before a knot
    for at in (start, near):
        sent = commands.joined(plan.delayed(epoch), epoch + at, PERIOD)
        stamps = np.rint(sent.times * 1e9)
        intervals = np.diff(stamps) * 1e-9
        assert np.all(intervals >= 0.999e-6)
        slopes = np.abs(np.diff(sent.speeds, axis=0)) / intervals[:, None]
        assert np.max(slopes) <= LIMIT * (1.0 + 1e-9)  # rounding of the quotient alone


def test_command_after_a_step_back_of_the_clock_begins_now_or_soon() -> None:
    commands = Commands(ROBOT)
    commands.sent.record(FirstOrderHold.constant(100.0, np.zeros(2)))
    assert commands.earliest(99.9) == 100.0
    assert commands.earliest(99.4) == 99.4
    assert commands.earliest(100.1) == 100.1
