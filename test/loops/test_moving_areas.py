# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loops on floors that are replaced often: plans are kept, and stops come in time."""

import numpy as np
import pytest
from floor_plans import SIDEWAYS, floor_of, pose
from sampled_loop import SampledLoop

from sphere_nmpc.model.course import Course
from sphere_nmpc.settings import ControllerSettings

pytestmark = pytest.mark.slow

RATE_50 = ControllerSettings(planning_effort=20_000, control_rate=50.0)


def test_a_floor_that_does_not_touch_what_is_planned_changes_nothing_but_the_clearance() -> None:
    """Announced ten times a second, while a leg is followed and the next one searched for."""
    loops = []
    for is_announced in (False, True):
        loop = SampledLoop(pose(1.0, 3.0), RATE_50, floor=floor_of([]))
        loop.controller.set_goal(Course.of(pose(2.0, 1.0), pose(4.5, 3.0, SIDEWAYS)))
        for _ in range(50):
            loop.run(0.1)
            loop.controller.floor = floor_of([]) if is_announced else loop.controller.floor
        loops.append(loop)
    np.testing.assert_array_equal(loops[0].states, loops[1].states)
    solved = [[decision.is_new for decision in loop.decisions] for loop in loops]
    assert solved[0] == solved[1]
    assert loop.controller.following.course.active.is_last
    before = loop.decision.plan
    loop.controller.floor = floor_of([(5.2, 2.5, 5.5, 3.5)])
    loop.sample()
    assert loop.decision.plan.hold is before.hold
    assert loop.decision.plan.clearance < before.clearance
    loop.controller.floor = floor_of([(4.0, 2.5, 5.0, 3.5)])
    loop.sample()
    assert loop.decision.plan.stops and "occupied" in loop.given_up


@pytest.mark.parametrize("late", [-0.2, 0.0, 0.2])
def test_it_rests_before_an_area_that_drives_across_its_way_touches_it(late: float) -> None:
    """The clearance is more than the area moves until it is announced and the sphere stops."""
    loop = SampledLoop(
        pose(1.0, 2.0), RATE_50, goal=pose(5.0, 2.0), floor=floor_of([], clearance=0.1),
        search_time=0.08,
    )
    corners = np.array([(2.5, 2.5), (3.0, 2.5), (3.0, 3.0), (2.5, 3.0)])
    corners[:, 1] += late
    assert not loop.run_with_area(corners, np.array([0.0, -0.2]), 9.0).any()
    assert sum(plan.stops for plan in loop.plans) > 5
