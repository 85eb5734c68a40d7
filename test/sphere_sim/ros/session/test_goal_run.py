# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A node is served until its run has settled, or ends without, and never waits for ever."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from sphere_sim.evaluation.metrics import GoalRun
from sphere_sim.ros.session.goal_run import StalledError, wait_until_settled

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


@pytest.mark.parametrize(
    ("errors", "options", "settled", "end"),
    [
        # Inside at 1 s, outside again at 2 s, for good from 3 s on.
        ((1.0, 0.05, 0.2, 0.05, 0.02, 0.01, 0.0), {}, 3.0, 5.0),
        ((0.0,) * 20, {"not_before": 7.0}, 0.0, 9.0),
        ((1.0, *[0.0] * 20), {"linger": 4.0}, 1.0, 7.0),
        ((1.0, *[0.0] * 20), {"linger": 40.0}, 1.0, 10.0),
        ((1.0,) * 20, {}, None, 10.0),
        ((1.0,) * 8 + (0.0,) * 3, {}, 8.0, 10.0),
    ],
    ids=["comes back", "was there before", "lingers", "lingers to the deadline", "never",
         "at the deadline"],
)
def test_run_settles_when_the_error_has_stayed_below_the_tolerance(
    errors, options, settled, end
) -> None:
    run = GoalRun(GOAL, tolerance=0.1, hold=2.0)
    assert wait_until_settled(run, poses(run, *errors), deadline=10.0, **options) == settled
    assert run.time == end


def test_orientation_of_opposite_sign_is_at_the_goal() -> None:
    run = GoalRun(GOAL, hold=0.0)
    run.observe(1.0, np.concatenate((GOAL[:2], -GOAL[2:])))
    assert run.settled_at() == 1.0


@pytest.mark.parametrize("time", [None, 2.5])
def test_time_that_stands_still_is_an_error(time) -> None:
    run = GoalRun(GOAL)
    if time is not None:
        run.observe(time, at(1.0))
    with pytest.raises(StalledError, match=f"stands still at {run.time:.2f} s"):
        wait_until_settled(run, lambda: None, deadline=10.0, stall_timeout=0.0)
