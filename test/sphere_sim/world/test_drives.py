# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The command that the drives follow, and their limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_sim.world.drives import CommandFollower

STEP = 0.01


@pytest.fixture
def follower() -> CommandFollower:
    return CommandFollower(max_speed=100.0, max_acceleration=400.0, command_timeout=0.5)


def hold(*knots: tuple[float, float, float]) -> FirstOrderHold:
    array = np.array(knots)
    return FirstOrderHold(array[:, 0], array[:, 1:])


def test_without_commands_the_rotors_ramp_to_rest(follower: CommandFollower) -> None:
    np.testing.assert_array_equal(follower.commanded(1.0), [0.0, 0.0])
    np.testing.assert_array_equal(follower.speeds_after(np.array([1.0, -9.0]), 0.0, STEP), [0, -5])


def test_hold_is_newer_unless_it_starts_before_the_last_one(follower: CommandFollower) -> None:
    assert follower.is_newer(hold((1, 0, 0)))
    follower.follow_trajectory(hold((1, 0, 0), (2, 5, 5)))
    assert follower.is_newer(hold((1, 0, 0))) and follower.is_newer(hold((1.1, 0, 0)))
    assert not follower.is_newer(hold((0.9, 0, 0)))


def test_trajectory_has_priority_over_speeds_until_its_last_knot(
    follower: CommandFollower,
) -> None:
    follower.follow_speeds(np.array([7.0, 7.0]), 0.0)
    follower.follow_trajectory(hold((0, 0, 0), (0.4, 40, 20)))
    np.testing.assert_allclose(follower.commanded(0.2), [20, 10])
    np.testing.assert_allclose(follower.commanded(0.4), [40, 20])
    np.testing.assert_allclose(follower.commanded(0.45), [0, 0])


def test_late_samples_of_a_trajectory_are_ignored_after_its_end(
    follower: CommandFollower,
) -> None:
    follower.follow_trajectory(hold((0, 40, 20), (0.4, 0, 0)))
    follower.follow_speeds(np.array([7.0, 7.0]), 0.3)
    np.testing.assert_allclose(follower.commanded(0.45), [0, 0])
    follower.follow_speeds(np.array([3.0, 3.0]), 0.5)
    np.testing.assert_allclose(follower.commanded(0.6), [0, 0])
    follower.follow_speeds(np.array([7.0, 7.0]), 0.91)
    np.testing.assert_allclose(follower.commanded(1.0), [7, 7])


def test_new_trajectory_replaces_the_previous_one_and_a_late_one_is_evaluated_now(
    follower: CommandFollower,
) -> None:
    follower.follow_trajectory(hold((0, 0, 0), (5, 50, 50)))
    follower.follow_trajectory(hold((0, 0, 0), (1, 30, 0), (2, 0, 0)))
    np.testing.assert_allclose(follower.commanded(1.5), [15, 0])
    np.testing.assert_allclose(follower.commanded(3.0), [0, 0])


def test_speeds_without_a_successor_are_dropped_after_the_timeout(
    follower: CommandFollower,
) -> None:
    follower.follow_speeds(np.array([7.0, -7.0]), 1.0)
    np.testing.assert_array_equal(follower.commanded(1.5), [7, -7])
    np.testing.assert_array_equal(follower.commanded(1.501), [0, 0])


@pytest.mark.parametrize(
    "bad", [[1.0], [1.0, 2.0, 3.0], [np.nan, 0.0], [0.0, np.inf], [[1.0, 2.0]]]
)
def test_invalid_speeds_are_refused_and_the_previous_ones_stay(
    follower: CommandFollower, bad: list[float]
) -> None:
    follower.follow_speeds(np.array([7.0, 7.0]), 0.0)
    with pytest.raises(InvalidInputError, match="two finite numbers"):
        follower.follow_speeds(np.array(bad), 0.1)
    np.testing.assert_array_equal(follower.commanded(0.2), [7, 7])


def test_commands_beyond_the_largest_speed_are_clamped_and_counted(
    follower: CommandFollower,
) -> None:
    follower.follow_speeds(np.array([100.0, 0.0]), 0.0)
    assert follower.clamped == 0
    follower.follow_speeds(np.array([500.0, 0.0]), 0.0)
    follower.follow_trajectory(hold((0, 0, 0), (1, 0, -101)))
    assert follower.clamped == 2
    speeds = np.array([0.0, -99.0])
    for i in range(200):
        speeds = follower.speeds_after(speeds, STEP * i, STEP)
        assert np.max(np.abs(speeds)) <= 100.0


speeds = st.tuples(st.floats(-100, 100), st.floats(-100, 100)).map(np.array)


@given(
    now=speeds, wanted=st.tuples(st.floats(-900, 900), st.floats(-900, 900)).map(np.array),
    step=st.floats(1e-9, 0.1),
)
def test_drives_keep_all_limits_and_approach_the_command_as_fast_as_they_allow(
    now: np.ndarray, wanted: np.ndarray, step: float
) -> None:
    follower = CommandFollower(100.0, 400.0, 0.5)
    follower.follow_speeds(wanted, 0.0)
    after = follower.speeds_after(now, 0.0, step)
    assert np.all(np.abs(after) <= 100.0)
    assert np.all(np.abs(after - now) <= 400.0 * step * (1.0 + 1e-12) + 1e-12)
    target = np.clip(wanted, -100.0, 100.0)
    reached = np.abs(target - now) <= 400.0 * step
    np.testing.assert_array_equal(after[reached], target[reached])
    assert np.all(np.abs(target - after) <= np.abs(target - now) + 1e-12)


def test_knots_between_two_times_are_those_of_the_trajectory(follower: CommandFollower) -> None:
    assert follower.knots_between(0.0, 9.0) == []
    follower.follow_trajectory(hold((0, 0, 0), (0.5, 1, 1), (1.0, 0, 0)))
    assert follower.knots_between(0.0, 1.0) == [0.5]
    assert follower.knots_between(0.5, 0.6) == []


def test_reset_discards_all_commands(follower: CommandFollower) -> None:
    follower.follow_speeds(np.array([7.0, 7.0]), 0.0)
    follower.follow_trajectory(hold((0, 0, 0), (5, 50, 50)))
    follower.reset()
    np.testing.assert_array_equal(follower.commanded(0.1), [0, 0])
