# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands and rotor speeds are checked against the limits of the drives."""

import numpy as np
import pytest

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_sim.faults.limits import LimitCheck

MAX_SPEED, MAX_ACCELERATION = 100.0, 400.0


@pytest.fixture
def check() -> LimitCheck:
    return LimitCheck(MAX_SPEED, MAX_ACCELERATION)


def hold(*knots: tuple[float, float, float]) -> FirstOrderHold:
    """Return a hold from rows of time [s] and two speeds [rad/s]."""
    rows = np.array(knots)
    return FirstOrderHold(rows[:, 0], rows[:, 1:])


def test_command_at_both_limits_is_kept(check) -> None:
    check.trajectory(hold((0.0, -100.0, 0.0), (0.5, 100.0, 0.0)))
    assert not check.broken
    assert check.worst_speed == 100.0
    assert check.worst_slew == pytest.approx(400.0)


def test_speed_beyond_the_limit_is_a_violation(check) -> None:
    check.trajectory(hold((0.0, 101.0, 0.0)))
    (violation,) = check.broken
    assert "rotor_trajectory" in violation and "101" in violation


def test_slew_beyond_the_limit_is_a_violation(check) -> None:
    check.trajectory(hold((0.0, 0.0, 0.0), (0.1, 0.0, 41.0)))
    (violation,) = check.broken
    assert "rad/s^2" in violation


def test_command_that_does_not_start_at_the_speeds_in_force_is_a_violation(check) -> None:
    check.trajectory(hold((0.0, 0.0, 0.0), (1.0, 50.0, 0.0)))
    check.trajectory(hold((0.5, 25.0, 0.0), (1.0, 0.0, 0.0)))
    assert not check.broken
    check.trajectory(hold((0.75, 12.0, 0.0), (1.0, 0.0, 0.0)))
    (violation,) = check.broken
    assert "0.5 rad/s away" in violation


def test_start_is_not_checked_where_the_sender_changes_or_time_restarts(check) -> None:
    check.continuous = False
    check.trajectory(hold((0.0, 0.0, 0.0), (1.0, 50.0, 0.0)))
    check.trajectory(hold((0.5, 0.0, 0.0), (1.0, 0.0, 0.0)))
    check.continuous = True
    check.restart()
    check.trajectory(hold((0.7, 30.0, 0.0), (1.0, 0.0, 0.0)))
    assert not check.broken


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_command_that_is_not_finite_is_a_violation(check, wrong) -> None:
    check.command(np.array([wrong, 0.0]))
    assert len(check.broken) == 1


def test_measured_speeds_are_checked(check) -> None:
    check.joints(0, np.array([0.0, 0.0]))
    check.joints(50_000_000, np.array([20.0, 0.0]))
    assert not check.broken
    check.joints(60_000_000, np.array([25.0, 0.0]))
    (violation,) = check.broken
    assert "joint_states" in violation
    assert check.worst_slew == pytest.approx(500.0, rel=1e-6)


def test_the_same_instant_again_is_no_slew(check) -> None:
    check.joints(10, np.array([5.0, 0.0]))
    check.joints(10, np.array([5.0, 0.0]))
    assert not check.broken and check.worst_slew == 0.0


def test_results_are_reset(check) -> None:
    check.command(np.array([200.0, 0.0]))
    check.begin()
    assert not check.broken and check.worst_speed == 0.0


def test_number_of_kept_violations_is_bounded(check) -> None:
    for _ in range(1000):
        check.command(np.array([200.0, 0.0]))
    assert 0 < len(check.broken) < 100


def test_measured_speeds_may_change_by_the_error_of_a_servo_more() -> None:
    stamp, change = 50_000_000, 20.0  # 400 rad/s^2 over 0.05 s
    for extra, violations in ((0.06, 0), (0.1, 1)):
        check = LimitCheck(MAX_SPEED, MAX_ACCELERATION, servo_error=0.07)
        check.joints(0, np.zeros(2))
        check.joints(stamp, np.array([0.0, change + extra]))
        assert len(check.broken) == violations
        assert check.worst_slew == pytest.approx((change + extra) / 0.05)
    exact = LimitCheck(MAX_SPEED, MAX_ACCELERATION)
    exact.joints(0, np.zeros(2))
    exact.joints(stamp, np.array([0.0, change + 0.06]))
    assert exact.broken


def test_command_that_was_lost_is_not_in_force(check) -> None:
    check.trajectory(hold((0.0, 0.0, 0.0), (1.0, 50.0, 0.0)))
    check.sent(hold((0.5, 25.0, 0.0), (1.0, 0.0, 0.0)))
    check.trajectory(hold((0.75, 37.5, 0.0), (1.0, 50.0, 0.0)))
    assert not check.broken
    check.sent(hold((0.8, 40.0, 0.0), (0.81, 0.0, 0.0)))
    assert "rad/s^2" in check.broken[0]


@pytest.mark.parametrize(("first", "violations"), [(24.0, 0), (50.0, 0), (52.0, 1), (18.0, 1)])
def test_command_after_a_late_one_starts_while_the_drives_catch_up(
    check, first: float, violations: int
) -> None:
    check.delivered(hold((0.0, 20.0, 0.0), (1.0, 20.0, 0.0)))
    late = hold((0.5, 20.0, 0.0), (0.6, 60.0, 0.0))
    for now in (0.57, 0.575):  # a copy is not another command
        check.delivered(late, now)
    check.delivered(hold((0.575, first, 0.0), (1.0, first, 0.0)))
    assert len(check.broken) == violations
    if not violations:
        check.delivered(hold((0.6, first + 1.0, 0.0), (1.0, first, 0.0)))
        assert len(check.broken) == 1, "the one before was in time"
