# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Courses: which of them are the same, legs put in front, goals that move."""

import numpy as np
import pytest

from sphere_nmpc.model.course import Course, Leg, LegEnd
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.state import upright_state

NEAR, FAR, ASIDE = (upright_state(x, y, 0.0) for x, y in ((1.0, 0.0), (2.0, 0.0), (1.0, 1.0)))


def test_course_of_goals_comes_to_rest_at_each_in_their_order() -> None:
    goals = Goal(NEAR), Goal(FAR, Orientation.ANY)
    course = Course.of(*goals)
    assert all(one is other for one, other in zip(course.goals, goals, strict=True))
    for leg in course.legs:
        assert leg.end is LegEnd.REST
        assert leg.time_left == leg.way_left == 0.0


def test_goals_of_a_course_cannot_be_written_to() -> None:
    course = Course.of(Goal(NEAR.copy()), Goal(FAR.copy(), rate=np.ones(5)))
    for goal in course.goals:
        for array in (goal.pose, goal.rate):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 7.0


def test_course_whose_goal_has_moved_has_the_same_origin_and_other_legs() -> None:
    course, moved = Course.of(Goal(NEAR), Goal(FAR)), Goal(ASIDE)
    found = course.aimed(1, moved)
    assert found.origin is course.origin
    assert found.legs[0] is course.legs[0], "it is compared by identity"
    assert found.legs[1].goal is moved and course.legs[1].goal is not moved
    assert found.aimed(1, course.goals[1]).origin is course.origin
    assert Course.of(*course.goals).origin is not course.origin


def test_leg_that_is_aimed_at_keeps_how_it_ends() -> None:
    leg = Leg(Goal(NEAR), LegEnd.THROUGH, time_left=3.0, way_left=2.0)
    found = Course((leg,)).aimed(0, Goal(FAR)).legs[0]
    assert (found.end, found.time_left, found.way_left) == (LegEnd.THROUGH, 3.0, 2.0)


def test_leg_put_in_front_is_followed_by_the_one_that_was_there() -> None:
    course, leg = Course.of(Goal(NEAR), Goal(FAR)), Leg(Goal(ASIDE), LegEnd.THROUGH)
    found = course.by_way_of(1, leg)
    assert found.legs == (course.legs[0], leg, course.legs[1])
    assert found.origin is course.origin


@pytest.mark.parametrize(
    ("other", "is_same"),
    [
        ([Goal(NEAR.copy()), Goal(FAR, since=3.0)], True),
        ([Goal(FAR), Goal(NEAR)], False),
        ([Goal(NEAR)], False),
        ([Goal(NEAR), Goal(FAR), Goal(FAR)], False),
        ([Goal(NEAR), Goal(FAR, Orientation.ANY)], False),
    ],
    ids=["the same", "another order", "fewer", "more", "demands less"],
)
def test_course_is_listed_in_another_with_the_same_goals_in_the_same_order(
    other: list[Goal], is_same: bool
) -> None:
    course, listed = Course.of(Goal(NEAR), Goal(FAR)), Course.of(*other)
    assert course.is_listed_in(listed) is listed.is_listed_in(course) is is_same
