# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Situations: the goal as it is now, members of its set, the same situation at time 0."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.model.course import Course, Leg, LegEnd
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.plant import PlantEstimate
from sphere_nmpc.model.state import POSITION, QUATERNION, upright_state, without_momentum
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.in_force import InForce
from sphere_nmpc.strategy.plan import Plan, PlanStatus

ROBOT = RobotParameters()
FIRST, SECOND = upright_state(1.0, 0.0, 0.5), upright_state(2.0, 1.0, -0.5)
RATE = np.array([0.2, -0.1, 0.0, 0.0, 0.3])
TURNED = without_momentum(upright_state(0.0, 0.0, 2.0))
SETS = [Orientation.ANY_HEADING, Orientation.ANY]


def situation(goal: Goal, time: float = 5.0) -> Situation:
    """Return one in which the second leg of a course is followed."""
    course = Course.of(Goal(FIRST), goal)
    in_force = FirstOrderHold(time + np.array([0.0, 0.4]), np.array([[3.0, 4.0], [0.0, 0.0]]))
    return Situation(time, TURNED, course, in_force, PlantEstimate(ROBOT.lumped), leg=1)


def test_goal_is_where_it_is_now() -> None:
    now = situation(Goal(SECOND, rate=RATE, since=3.0))
    assert now.goal.since == 5.0
    np.testing.assert_allclose(now.goal.pose, now.course.goals[1].at(5.0))
    np.testing.assert_allclose(now.goal.at(6.0), now.course.goals[1].at(6.0), atol=1e-12)
    still = situation(Goal(SECOND))
    assert still.goal is still.course.goals[1], "compared by identity"
    assert still.aim(still.goal.pose) is still.goal
    assert still.aimed_at(still.goal) is still
    np.testing.assert_array_equal(still.speeds, [3.0, 4.0])


@pytest.mark.parametrize("kind", SETS)
def test_member_that_is_nearest_belongs_to_the_same_course(kind: Orientation) -> None:
    now = situation(Goal(SECOND, kind, RATE, since=3.0))
    near = now.nearest_to(TURNED)
    assert near.course.origin is now.course.origin and near.leg == now.leg
    assert near.course.legs[0] is now.course.legs[0]
    np.testing.assert_allclose(near.goal.pose[POSITION], now.goal.pose[POSITION])
    np.testing.assert_allclose(near.goal.pose[QUATERNION], TURNED[QUATERNION], atol=1e-12)
    assert near.goal.orientation is kind and near.goal.since == now.time
    np.testing.assert_array_equal(near.goal.rate, RATE)


def test_whole_pose_is_its_own_nearest_member() -> None:
    now = situation(Goal(SECOND, rate=RATE, since=3.0))
    assert now.nearest_to(TURNED) is now


def test_situation_that_is_aimed_elsewhere_keeps_origin_and_end_of_its_leg() -> None:
    now = situation(Goal(SECOND))
    leg = Leg(Goal(SECOND), LegEnd.THROUGH, 2.0, 1.0)
    now = replace(now, course=Course((now.course.legs[0], leg), now.course.origin))
    aimed = now.aimed_at(now.aim(FIRST))
    assert aimed.goal.pose is FIRST and aimed.goal.since == now.time
    assert aimed.course.origin is now.course.origin
    assert aimed.course.legs[1].end is LegEnd.THROUGH
    assert aimed.course.legs[1].time_left == 2.0
    assert now.goal.pose is SECOND, "the other one is as it was"


@pytest.mark.parametrize("rate", [np.zeros(5), RATE], ids=["stands", "moves"])
def test_situation_at_time_0_is_the_same(rate: np.ndarray) -> None:
    now = situation(Goal(SECOND, rate=rate, since=3.0))
    moved = now.from_zero()
    assert (moved.leg, len(moved.course.legs)) == (0, 1), "it is handed to another process"
    assert moved.time == moved.in_force.start == 0.0
    assert moved.course.origin is now.course.origin
    np.testing.assert_array_equal(moved.in_force.speeds, now.in_force.speeds)
    assert moved.in_force.end == pytest.approx(0.4)
    for ahead in (0.0, 2.0):
        np.testing.assert_allclose(
            moved.goal.at(ahead), now.goal.at(now.time + ahead), atol=1e-12
        )


def test_deviations_follow_from_the_covariance() -> None:
    exact = situation(Goal(SECOND))
    assert exact.place_deviation == exact.uncertainty == 0.0
    variances = np.diag([4e-4, 1e-4, 0.0, 0.0, 4e-4])
    noisy = replace(exact, covariance=variances)
    assert noisy.place_deviation == pytest.approx(0.02)
    # A rotation by a small angle moves its quaternion half as far.
    assert noisy.uncertainty == pytest.approx(np.sqrt(4e-4 + 1e-4 + 1e-4))


def test_situation_of_one_goal_has_no_other_leg() -> None:
    for goal in (SECOND, Goal(SECOND)):
        one = Situation.of(2.0, TURNED, goal, np.array([1.0, 2.0]), ROBOT.lumped, time_budget=0.5)
        assert len(one.course.legs) == 1 and one.goal.pose is SECOND
        assert one.time_budget == 0.5 and one.constants == ROBOT.lumped
        np.testing.assert_array_equal(one.in_force.at(9.0), [1.0, 2.0])


def test_plan_stands_while_leg_floor_plant_and_disturbance_are_the_same_objects() -> None:
    now = situation(Goal(SECOND))
    hold = FirstOrderHold.constant(now.time, np.zeros(2))
    plan = Plan(hold, now.state[None, :], PlanStatus.HOLDING, until=8.0, tolerance=1e-3)
    in_force = InForce(plan, now, ROBOT)
    inputs = in_force.inputs
    assert in_force.stands(6.0, now.state, 0.0, inputs)
    assert not in_force.stands(5.0, now.state, 0.0, inputs), "the instant of the plan itself"
    assert not in_force.stands(8.0, now.state, 0.0, inputs), "another one is wanted"
    for k, other in enumerate((
        Leg(Goal(SECOND)), object(), replace(now.plant), replace(now.disturbance)
    )):
        assert not in_force.stands(6.0, now.state, 0.0, (*inputs[:k], other, *inputs[k + 1 :]))
    away = now.state + np.array([2e-3, *np.zeros(8)])
    assert not in_force.stands(6.0, away, 1e-3, inputs)
    assert in_force.stands(6.0, away, 3e-3, inputs), "as far as is known"
