# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals: several in order, sets of poses, tolerances, what is told of the arrival, moving ones."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from sampled_loop import ROBOT, SampledLoop
from situations import situation

from sphere_nmpc.control.active_course import ActiveCourse
from sphere_nmpc.control.goal_motion import GoalMotion, current
from sphere_nmpc.control.monitors import relative_error
from sphere_nmpc.model import rotation
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.state import (
    POSITION,
    Vector,
    angle_error,
    make_state,
    position_error,
    state_error,
    upright_state,
)
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import make_strategy
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios

pytestmark = pytest.mark.slow

SETTINGS = ControllerSettings()
START = upright_state(0.0, 0.0, 0.0)
SQUARE = [upright_state(0.4, 0.0, 0.0), upright_state(0.4, 0.3, 1.0), upright_state(0.0, 0.3, 0.0)]
LONGEST = 12.0
"""Time within which the ideal sphere is at a near goal [s]; it takes 4 s."""


def course(*poses: Vector, stamp: int = 1) -> ActiveCourse:
    return ActiveCourse(Course.of(*map(Goal, poses)), stamp)


def test_what_remains_is_that_of_all_goals() -> None:
    controller = SampledLoop(START).controller
    assert np.isnan(controller.following.remaining(1.0, 1.0)).all(), "no goal"
    assert controller.following.take(course(*SQUARE))
    assert not controller.following.take(course(*SQUARE, stamp=2))
    assert np.isnan(controller.following.remaining(1.0, 1.0)).all(), "no pose"
    controller.observe(0.0, START)
    time, way = controller.following.remaining(math.nan, math.nan)
    assert way == pytest.approx(0.4 + 0.3 + 0.4), "along straight lines"
    assert time == pytest.approx(3 * 2.0 + way / 0.742, rel=1e-3)
    planned = controller.following.remaining(3.5, 0.6)
    assert planned == pytest.approx((3.5 + 2 * 2.0 + 0.7 / 0.742, 0.6 + 0.7), rel=1e-3)
    resting = controller.following.remaining(math.nan, 0.0)
    assert resting == pytest.approx((2 * 2.0 + 0.7 / 0.742, 0.7), rel=1e-3)


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
    goal = upright_state(position, 0.0, angle)
    loop = SampledLoop(START, ControllerSettings(**tolerances), goal=goal)
    loop.sample()
    found = relative_error(loop.decision.state, loop.decision.goal, loop.settings)
    assert found == pytest.approx(expected, rel=1e-3)


def test_sphere_is_at_a_goal_that_it_need_not_be_turned_to() -> None:
    settings = replace(SETTINGS, orientation_tolerance=3.2)
    loop = SampledLoop(START, settings, goal=upright_state(0.5, 0.2, 0.0))
    loop.run(LONGEST)
    assert loop.controller.at_goal


def test_arrival_and_distance_are_told_from_the_first_plan_on() -> None:
    loop = SampledLoop(START, goal=SQUARE[1])
    arrivals, ways = [], []
    while loop.time < LONGEST:
        loop.run(loop.settings.control_period)
        if loop.decision.mode is Kind.AT_GOAL:
            break
        arrivals.append(loop.decision.plan.arrival)
        ways.append(loop.decision.plan.way_left(loop.time))
    # It has to stay for a sample period, from the first sample within the tolerance on, which it
    # may enter just before it arrives.
    first = loop.time - 2.0 * loop.settings.period
    assert first - loop.settings.period < np.nanmedian(arrivals) < first + 0.05
    rolled = np.sum(np.linalg.norm(np.diff(loop.places, axis=0), axis=1))
    # The pieces between knots count as straight, and the first plan was replaced by a better one.
    assert 0.8 * rolled < ways[0] < 1.1 * rolled and ways[-1] < 0.05


SETS = [Orientation.ANY_HEADING, Orientation.ANY]
SCENARIOS = draw_scenarios(12, 21, "anywhere")


def duration(scenario: Scenario, kind: Orientation) -> float:
    """Return the duration of the first plan [s]."""
    goal = Goal(kind.nearest(scenario.goal, scenario.start), kind)
    now = situation(goal, pose=scenario.start)
    return make_strategy(SETTINGS, ROBOT).plan(now).arrival


def test_first_plan_to_a_set_is_no_longer() -> None:
    full, *free = (
        np.array([duration(scenario, kind) for scenario in SCENARIOS])
        for kind in (Orientation.FULL, *SETS)
    )
    for kind, found in zip(SETS, free, strict=True):
        # Plans are found by a random search: 3 % is about its 90th percentile.
        assert np.all(found < 1.03 * full)
        assert np.median(found / full) < (0.95 if kind is Orientation.ANY else 1.0)


def at_set(loop: SampledLoop, goal: Vector, kind: Orientation) -> None:
    """Run to a set, at which the sphere has to arrive and stay."""
    loop.controller.set_goal(Goal(goal, kind))
    loop.run(14.0)
    assert loop.decision.mode is Kind.AT_GOAL, loop.decision.plan.message
    assert loop.decision.error < 1e-2
    assert loop.controller.failures == 0
    assert np.linalg.norm(loop.pose - kind.nearest(goal, loop.pose)) < 1e-2


@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("strategy", ["time_optimal", "plan_keeping", "pushed"])
def test_sphere_arrives_and_rests_at_a_set(strategy: str, kind: Orientation) -> None:
    if strategy == "pushed":
        goal = upright_state(1.0, 0.5, 0.0)
        loop = SampledLoop(START)
        loop.controller.set_goal(Goal(goal, kind))
        loop.run(0.5)
        loop.plant.push(np.array([0.4, -0.3]))
        at_set(loop, goal, kind)
    else:
        loop = SampledLoop(SCENARIOS[0].start, replace(SETTINGS, strategy=strategy))
        at_set(loop, SCENARIOS[0].goal, kind)
        assert not np.any(np.abs(loop.plant.rotor_speeds) > 0.5)


@pytest.mark.parametrize("point", [START, upright_state(1.0, 0.0, 0.0), (0.0, 0.001, *START[2:])])
def test_round_numbers_and_the_place_where_it_is(point: Vector) -> None:
    at_set(SampledLoop(START), np.array(point), Orientation.ANY)


SPACING = 0.1
"""Time between two goals [s]."""


def line(velocity: Vector, seed: int, until: float = np.inf) -> Callable[[float], Vector]:
    """Return the pose of a goal by the time [s]; it stands from `until` on."""
    rng = np.random.default_rng(seed)
    begin, turn = rng.uniform(-1.0, 1.0, 2), rotation.random_quaternion(rng)
    return lambda time: make_state(begin + min(time, until) * velocity, turn)


def followed(
    goal: Callable[[float], Vector], kind: Orientation, noise: float = 0.0, duration: float = 16.0,
    gone: float = np.inf,
) -> tuple[SampledLoop, float, float]:
    """Follow a goal that is given with noise [m], until it is `gone` [s].

    Returns the loop, and the medians of the errors of position [m] and angle [deg] from 8 s on,
    when it is met: the motions take 2 to 6 s.
    """
    rng, loop = np.random.default_rng(7), SampledLoop(START)
    errors = []
    for count in range(round(2.0 * duration / SPACING)):
        now = loop.time
        if count % 5 == 0:
            loop.sample()
        if count % 2 == 0 and now < gone:
            given = goal(now).copy()
            given[POSITION] += noise * rng.standard_normal(2)
            loop.controller.following.take(ActiveCourse(Course.of(Goal(given, kind))), now)
        loop.advance(0.5 * SPACING)
        near = kind.nearest(goal(loop.time), loop.pose)
        if loop.time > 8.0:
            errors.append((position_error(loop.pose, near), angle_error(loop.pose, near)))
    assert loop.controller.failures == 0
    position, angle = np.median(errors, axis=0)
    return loop, float(position), float(np.degrees(angle))


@pytest.mark.parametrize("noise", [1e-3, 5e-3])
def test_sphere_rests_at_a_noisy_goal(noise: float) -> None:
    loop, position, angle = followed(line(np.zeros(2), 1), Orientation.FULL, noise)
    # A goal that is given is off by 1.2 times the noise in the median, and is turned by nothing.
    assert position < noise and angle < 0.25
    assert loop.controller.at_goal


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.5])
def test_point_that_moves_is_met_and_kept(speed: float) -> None:
    loop, position, _ = followed(line(speed * np.array([0.8, -0.6]), 2), Orientation.ANY)
    assert position < 0.01 * speed, "what it moves in 10 ms"
    assert loop.controller.following.goal_speed(loop.time) == pytest.approx(speed, rel=1e-3)
    assert loop.controller.at_goal


def test_noisy_point_that_moves_is_kept() -> None:
    assert followed(line(np.array([0.0, 0.3]), 3), Orientation.ANY, 5e-3)[1] < 5e-3


def test_pose_that_moves_is_met_again_and_again() -> None:
    _, *found = followed(line(np.array([0.1, 0.0]), 4), Orientation.FULL, duration=24.0)
    # What it moves in a second, and 7 to 17 degrees; they are 86 where its motion is not foreseen.
    assert found[0] < 0.1 and found[1] < 30.0


@pytest.mark.parametrize("gone", [np.inf, 10.0], ids=["is still given", "is no longer given"])
def test_goal_that_stands_in_the_end_is_settled_at(gone: float) -> None:
    goal = line(np.array([0.1, 0.05]), 5, until=10.0)
    loop, *_ = followed(goal, Orientation.FULL, gone=gone, duration=20.0)
    assert loop.controller.at_goal
    # The last one given may be that of the time before.
    older = SPACING * math.hypot(0.1, 0.05) if gone == 10.0 else 0.0
    assert position_error(loop.pose, goal(10.0)) < older + 1e-3


def test_another_goal_is_no_motion() -> None:
    motion = GoalMotion()
    second = Goal(upright_state(1.0, 0.0, 0.0))
    less = Goal(second.pose, Orientation.ANY)
    assert motion.update(0.0, Goal(START))[1]
    for time, goal, is_other in (
        (0.1, second, True),  # too far away
        (1.0, second, True),  # too late
        (1.1, less, True),  # demands less
        (1.2, less, False),
        (1.2, less, True),  # the same time
    ):
        assert motion.update(time, goal)[1] is is_other, time


def test_goal_after_a_list_is_another_one_however_near_to_that_before_it() -> None:
    controller, near = SampledLoop(START).controller, upright_state(0.05, 0.0, 0.0)
    for k, poses in enumerate(([START], [START, near], [near])):
        assert controller.following.take(course(*poses), 0.1 * k)
    assert controller.active.is_last


def test_rate_is_that_of_the_stamps_also_of_a_goal_that_turns() -> None:
    motion, moving = GoalMotion(), Goal(START, rate=np.array([0.2, 0.1, 0.3, 0.0, -0.4]))
    for k in range(30):
        # Not equally spaced.
        time = 0.1 * k + 0.03 * (k % 3)
        found, _ = motion.update(time, Goal(moving.at(time)))
    np.testing.assert_allclose(found.rate, moving.rate, atol=5e-3)
    assert position_error(found.at(5.0), moving.at(5.0)) < 0.01
    assert not current(found, time + 1.0).rate.any(), "no longer given"


def test_pose_of_another_robot_that_rolls_is_followed() -> None:
    """The goal turns as it rolls, at 1 rad/s, and is given at 100 Hz."""
    rate = np.array([0.3, 0.0, 0.0, 0.3 / ROBOT.shell_radius, 0.0])
    motion, moving = GoalMotion(), Goal(START, rate=rate)
    for k in range(500):
        found, is_other = motion.update(0.01 * k, Goal(moving.at(0.01 * k)))
        assert not is_other or k == 0
        if k > 20:
            np.testing.assert_allclose(found.rate, rate, atol=1e-6)
    late, _ = motion.update(4.995, Goal(moving.at(5.0)))
    assert state_error(late.at(5.0), moving.at(5.0)) < 0.01, "the newest counts"


def test_goal_that_moves_in_another_way_is_noticed_at_once() -> None:
    motion = GoalMotion()
    for k in range(20):
        place = min(0.1 * k, 1.0) * 0.3
        found, is_other = motion.update(0.1 * k, Goal(upright_state(place, 0.0, 0.0)))
        assert not is_other or k == 0
        if k > 13:
            assert abs(found.rate[0]) < 1e-3
            assert position_error(found.pose, upright_state(0.3, 0.0, 0.0)) < 1e-3
