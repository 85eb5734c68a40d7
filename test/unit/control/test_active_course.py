# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Course in force: which goals count as the same as those before."""

import numpy as np
import pytest

from sphere_nmpc.control.active_course import ActiveCourse, CourseInForce
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.path import Path
from sphere_nmpc.model.state import Vector, upright_state

POSES = [upright_state(x, 0.0, 0.0) for x in (1.0, 2.0, 3.0)]
VELOCITY = 0.2


def given(*poses: Vector, stamp: int = 1) -> ActiveCourse:
    return ActiveCourse(Course.of(*map(Goal, poses)), stamp)


def moving(time: float) -> ActiveCourse:
    return given(upright_state(1.0 + VELOCITY * time, 0.0, 0.0), stamp=round(1e9 * time))


@pytest.fixture
def course() -> CourseInForce:
    """A course of three goals, whose second leg is followed."""
    made = CourseInForce()
    assert made.take(given(*POSES), None, False)
    made.advance()
    return made


@pytest.mark.parametrize("time", [None, 1.0], ids=["without a time", "with a time"])
def test_list_that_is_given_again_goes_on_with_the_new_stamp(course, time) -> None:
    legs, origin = course.active.course.legs, course.active.course.origin
    assert not course.take(given(*POSES, stamp=2), time, False)
    assert (course.active.index, course.active.stamp) == (1, 2)
    assert course.active.course.legs is legs, "by identity, so that the plan stands"
    assert course.active.course.origin is origin and not course.active.is_last


def test_list_that_is_given_again_at_its_end_begins_again(course) -> None:
    course.advance()
    assert course.active.is_last and course.active.goal.equals(Goal(POSES[2]))
    origin = course.active.course.origin
    assert course.take(given(*POSES, stamp=3), None, True)
    assert (course.active.index, course.active.stamp) == (0, 3)
    assert course.active.course.origin is not origin


def test_path_that_is_given_again_is_begun_again_at_its_end_and_replaced_by_another_one() -> None:
    direct, round_about = [[0.0, 0.0], [2.0, 0.0]], [[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]]
    course, taken = CourseInForce(), []
    for number, (places, at_end) in enumerate(
        [(direct, False), (direct, False), (direct, True), (round_about, False)]
    ):
        paths = Path.through(np.array(places), 0.02, 0.3)
        taken.append(course.take(ActiveCourse(Course.along(*paths)), 0.2 * number, at_end))
    assert taken == [True, False, True, True]
    assert course.take(given(POSES[1]), 0.8, False) and not course.active.course.paths


def test_single_goal_that_is_given_again_at_its_end_is_not_begun_again() -> None:
    course = CourseInForce()
    assert course.take(given(POSES[0]), None, False)
    leg = course.active.leg
    assert not course.take(given(POSES[0], stamp=2), None, True)
    assert course.active.leg is leg and course.active.stamp == 2


@pytest.mark.parametrize(
    "other",
    [POSES[:2], POSES[::-1], [*POSES, POSES[0]], POSES[:1]],
    ids=["fewer", "another order", "more", "one"],
)
def test_other_list_is_followed_from_its_first_goal_on(course, other) -> None:
    origin = course.active.course.origin
    assert course.take(given(*other, stamp=2), None, False)
    assert (course.active.index, course.active.stamp) == (0, 2)
    assert course.active.course.origin is not origin


def test_single_goal_that_moves_keeps_the_origin_and_learns_its_rate() -> None:
    course = CourseInForce()
    assert course.take(moving(0.0), 0.0, False)
    origin = course.active.course.origin
    for k in range(1, 12):
        assert not course.take(moving(0.1 * k), 0.1 * k, False)
        assert course.active.course.origin is origin
        assert course.active.stamp == round(1e8 * k)
    np.testing.assert_allclose(course.active.goal.rate[:2], [VELOCITY, 0.0], atol=1e-6)
    assert course.at(1.2).course.origin is origin
    assert course.active.goal.at(1.2)[0] == pytest.approx(1.0 + 1.2 * VELOCITY)


def test_goal_that_is_no_longer_given_stands_and_is_still_the_same() -> None:
    course = CourseInForce()
    for k in range(12):
        course.take(moving(0.1 * k), 0.1 * k, False)
    origin = course.active.course.origin
    stands = course.at(5.0)
    assert stands is course.active and not stands.goal.rate.any()
    assert stands.course.origin is origin
    assert course.at(6.0) is stands, "by identity, so that the plan stands"


def test_goals_that_are_given_up_are_none_and_are_followed_anew_when_given_again(course) -> None:
    assert course.clear() and not course.clear()
    assert course.active is None and course.at(1.0) is None
    course.advance()
    assert course.take(given(*POSES), None, False)
    assert course.active.index == 0
