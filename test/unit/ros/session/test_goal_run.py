# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A node is served until its run has settled."""

import numpy as np
import pytest

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
        ((1.0, *[0.0] * 20), {"linger": 4.0}, 1.0, 7.0),
        ((1.0, *[0.0] * 20), {"linger": 40.0}, 1.0, 10.0),
        ((1.0,) * 8 + (0.0,) * 3, {}, 8.0, 10.0),
    ],
)
def test_run_settles_when_the_error_has_stayed_below_the_tolerance(
    errors, options, settled, end
) -> None:
    run = GoalRun(GOAL, tolerance=0.1, hold=2.0)
    assert wait_until_settled(run, poses(run, *errors), deadline=10.0, **options) == settled
    assert run.time == end


def test_time_that_stands_still_is_an_error() -> None:
    run = GoalRun(GOAL)
    run.observe(2.5, at(1.0))
    with pytest.raises(StalledError, match=r"stands still at 2\.50 s"):
        wait_until_settled(run, lambda: None, deadline=10.0, stall_timeout=0.0)
