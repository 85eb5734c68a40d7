# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Several goals in order, tolerances of their own, and what is told of the arrival."""

import math
from dataclasses import replace

import numpy as np
import pytest
from sampled_loop import SampledLoop

from sphere_nmpc.conditions import Kind
from sphere_nmpc.control.monitors import relative_error
from sphere_nmpc.model.goal import Goal, GoalSequence
from sphere_nmpc.model.state import Vector, state_error, upright_state
from sphere_nmpc.settings import ControllerSettings

START = upright_state(0.0, 0.0, 0.0)
SQUARE = [upright_state(0.4, 0.0, 0.0), upright_state(0.4, 0.3, 1.0), upright_state(0.0, 0.3, 0.0)]
LONGEST = 12.0
"""Time within which the ideal sphere is at a near goal [s]; it takes 4 s."""


def goal_sequence(*poses: Vector, stamp: int = 1) -> GoalSequence:
    return GoalSequence(tuple(Goal(pose) for pose in poses), stamp)


def until_index(loop: SampledLoop, index: int) -> None:
    """Run until another goal of the list is aimed at."""
    end = loop.simulator.time + LONGEST
    while loop.controller.goal_sequence.index < index:
        assert loop.simulator.time < end, loop.decision
        loop.run(loop.settings.control_period)


def test_what_remains_is_that_of_all_goals() -> None:
    controller = SampledLoop(START).controller
    assert np.isnan(controller.remaining(1.0, 1.0)).all(), "no goal"
    controller.set_goals(goal_sequence(*SQUARE))
    assert np.isnan(controller.remaining(1.0, 1.0)).all(), "no pose"
    controller.observe(0.0, START)
    time, way = controller.remaining(math.nan, math.nan)
    assert way == pytest.approx(0.4 + 0.3 + 0.4), "along straight lines"
    assert time == pytest.approx(3 * 2.0 + way / 0.742, rel=1e-3)
    planned = controller.remaining(3.5, 0.6)
    assert planned == pytest.approx((3.5 + 2 * 2.0 + 0.7 / 0.742, 0.6 + 0.7), rel=1e-3)
    resting = controller.remaining(math.nan, 0.0)
    assert resting == pytest.approx((2 * 2.0 + 0.7 / 0.742, 0.7), rel=1e-3)


def test_goals_are_visited_in_order_each_within_the_tolerance() -> None:
    loop = SampledLoop(START)
    controller = loop.controller
    assert controller.set_goals(goal_sequence(*SQUARE))
    for k, pose in enumerate(SQUARE[:-1]):
        loop.states = []
        until_index(loop, k + 1)
        assert not controller.at_goal, "other goals follow"
        assert min(state_error(state, pose) for state in loop.states) < 1e-2
    loop.run(LONGEST)
    assert controller.at_goal and loop.decision.mode is Kind.AT_GOAL
    assert state_error(loop.pose, SQUARE[-1]) < 1e-2
    assert controller.set_goals(goal_sequence(*SQUARE)), "all were visited: once more"
    assert controller.goal_sequence.index == 0
    assert controller.plans >= 3


def test_repeated_list_goes_on_and_another_one_replaces_it() -> None:
    loop = SampledLoop(START)
    controller = loop.controller
    controller.set_goals(goal_sequence(*SQUARE))
    until_index(loop, 1)
    assert not controller.set_goals(goal_sequence(*SQUARE, stamp=2))
    assert (controller.goal_sequence.index, controller.goal_sequence.stamp) == (1, 2)
    assert controller.set_goals(goal_sequence(*SQUARE[::-1]))
    assert controller.goal_sequence.index == 0
    np.testing.assert_array_equal(controller.goal, SQUARE[-1])


@pytest.mark.parametrize(
    ("tolerances", "position", "angle", "expected"),
    [
        ({}, 0.006, 0.0, 0.6),
        ({}, 0.0, 0.01, 0.5),  # an angle counts half in R^6
        ({"position_tolerance": 0.1}, 0.05, 0.005, 0.5),
        ({"position_tolerance": 0.1}, 0.0, 0.03, 1.5),  # twice goal_tolerance
        ({"orientation_tolerance": 0.3}, 0.005, 0.03, 0.5),
        ({"position_tolerance": 0.2, "orientation_tolerance": math.pi}, 0.05, 3.0, 3.0 / math.pi),
    ],
)
def test_tolerances_apart_count_by_the_larger_ratio(tolerances, position, angle, expected) -> None:
    loop = SampledLoop(START, ControllerSettings(**tolerances))
    loop.controller.set_goal(upright_state(position, 0.0, angle))
    loop.sample()
    assert relative_error(loop.decision, loop.settings) == pytest.approx(expected, rel=1e-3)


def test_sphere_is_at_a_goal_that_it_need_not_be_turned_to() -> None:
    loop = SampledLoop(START, replace(ControllerSettings(), orientation_tolerance=3.2))
    loop.controller.set_goal(upright_state(0.5, 0.2, 0.0))
    loop.run(LONGEST)
    assert loop.controller.at_goal


def test_arrival_and_distance_are_told_from_the_first_plan_on() -> None:
    loop = SampledLoop(START)
    loop.controller.set_goal(SQUARE[1])
    arrivals, ways = [], []
    while loop.simulator.time < LONGEST:
        loop.run(loop.settings.control_period)
        now, plan = loop.simulator.time, loop.decision.plan
        if loop.decision.mode is Kind.AT_GOAL:
            break
        arrivals.append(plan.arrival)
        ways.append(plan.distance_left(now))
    came = now - loop.settings.period
    known = [arrival for arrival in arrivals if not math.isnan(arrival)]
    assert abs(np.median(known) - came) < 0.3
    rolled = np.sum(np.linalg.norm(np.diff(np.array(loop.states)[:, :2], axis=0), axis=1))
    # The pieces between knots count as straight, and the first plan was replaced by a better one.
    assert 0.8 * rolled < ways[0] < 1.1 * rolled and ways[-1] < 0.05
