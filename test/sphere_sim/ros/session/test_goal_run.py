# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A run has settled once the error has stayed below the tolerance, and ends in time without."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from sphere_sim.ros.session.goal_run import (
    GoalRun,
    StalledError,
    wait_until,
    wait_until_settled,
)

GOAL = np.array([1.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def at(distance: float) -> np.ndarray:
    """Return a state at a distance from the goal [m]."""
    return GOAL + np.array([distance, 0.0, 0.0, 0.0, 0.0, 0.0])


def poses(run: GoalRun, *errors: float):
    """Return a function that gives the run its next pose, 1 s after the last one."""
    left = iter(enumerate(errors))

    def spin() -> None:
        time, error = next(left)
        run.observe(float(time), at(error))

    return spin


def test_run_settles_when_the_error_has_stayed_below_the_tolerance() -> None:
    run = GoalRun(GOAL, tolerance=0.1, hold=2.0)
    # Inside at 1 s, outside again at 2 s, for good from 3 s on.
    spin = poses(run, 1.0, 0.05, 0.2, 0.05, 0.02, 0.01, 0.0)
    assert wait_until_settled(run, spin, deadline=100.0) == 3.0
    assert run.time == 5.0
    assert run.error == pytest.approx(0.01)


def test_goal_that_was_reached_before_counts_only_from_a_later_time_on() -> None:
    run = GoalRun(GOAL, tolerance=0.1, hold=2.0)
    spin = poses(run, *[0.0] * 20)
    assert wait_until_settled(run, spin, deadline=100.0, not_before=7.0) == 0.0
    assert run.time == 9.0


def test_run_is_given_up_at_its_deadline() -> None:
    run = GoalRun(GOAL)
    assert wait_until_settled(run, poses(run, *[1.0] * 20), deadline=5.0) is None
    assert run.time == 5.0


def test_run_that_settles_at_its_deadline_has_settled() -> None:
    run = GoalRun(GOAL, hold=5.0)
    assert wait_until_settled(run, poses(run, *[0.0] * 20), deadline=5.0) == 0.0


def test_orientation_of_opposite_sign_is_at_the_goal() -> None:
    run = GoalRun(GOAL, hold=0.0)
    run.observe(1.0, np.concatenate((GOAL[:2], -GOAL[2:])))
    assert run.settled_at() == 1.0


def test_node_is_served_until_a_time() -> None:
    run = GoalRun(GOAL)
    wait_until(run, poses(run, *[1.0] * 20), 4.0)
    assert run.time == 4.0


@pytest.mark.parametrize("time", [None, 2.5])
def test_time_that_stands_still_is_an_error(time) -> None:
    run = GoalRun(GOAL)
    if time is not None:
        run.observe(time, at(1.0))
    with pytest.raises(StalledError, match=f"stands still at {run.time:.2f} s"):
        wait_until_settled(run, lambda: None, deadline=10.0, stall_timeout=0.0)
