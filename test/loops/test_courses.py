# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Courses of several legs: the next one is planned while the present one is followed."""

from dataclasses import replace

import numpy as np
import pytest
from floor_plans import DOORWAY, RADIUS, floor_of, least_distance, pose
from given_plans import Given, plan_of
from sampled_loop import SampledLoop

from sphere_nmpc.control.active_course import ActiveCourse
from sphere_nmpc.model.course import Course, Leg, LegEnd
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.state import POSITION, Vector, make_state, upright_state
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_sim.world.disturbances import DisturbanceSettings

pytestmark = pytest.mark.slow

SETTINGS = ControllerSettings()
FAST = replace(SETTINGS, control_rate=64.0)
START = upright_state(0.0, 0.0, 0.0)
LEANING = make_state((1.0, 1.2), (0.8, 0.6, 0.0, 0.0))
POSES = [upright_state(1.2, 0.0, 0.5), LEANING, upright_state(-0.5, 0.8, 3.0), START]
LONGEST = 40.0
"""Time in which four goals are visited [s]; it takes 15 s."""
REACHED = 1e-2


def follow(loop: SampledLoop, goals: list[Vector], kind: Orientation = Orientation.FULL) -> None:
    """Put a list of goals in force."""
    course = Course.of(*(Goal(one, kind) for one in goals))
    loop.controller.following.take(ActiveCourse(course, 1))


def run_to_the_end(loop: SampledLoop) -> list[float]:
    """Run until the last goal is reached; return the times at which a leg was followed first."""
    began, index = [loop.time], loop.controller.active.index
    while not loop.controller.at_goal:
        assert loop.time < LONGEST, loop.decision
        loop.run(loop.settings.control_period)
        if loop.controller.active.index > index:
            index = loop.controller.active.index
            began.append(loop.time)
    assert loop.controller.failures == 0, loop.controller.last_failure
    loop.check_limits()
    return began


def are_visited(loop: SampledLoop, goals: list[Vector], tolerance: float = REACHED) -> bool:
    """Return whether all goals were reached one after the other."""
    first = 0
    for goal in goals:
        near = np.flatnonzero(loop.errors(goal)[first:] < tolerance)
        if not near.size:
            return False
        first += int(near[0])
    return True


@pytest.mark.parametrize(
    ("settings", "search_time"), [(SETTINGS, None), (FAST, 0.05)], ids=["in line", "beside"]
)
def test_a_list_takes_as_long_as_its_single_motions(settings, search_time) -> None:
    single = 0.0
    for start, goal in zip([START, *POSES[:-1]], POSES, strict=True):
        loop = SampledLoop(start, settings, goal=goal, search_time=search_time)
        loop.run(8.0)
        single += loop.settled(goal)
    loop = SampledLoop(START, settings, search_time=search_time)
    follow(loop, POSES)
    run_to_the_end(loop)
    assert are_visited(loop, POSES)
    # 0.99 to 1.03 in some dozen lists; with a rest of a sample period at each goal 1.1 or more.
    assert loop.settled(POSES[-1]) < 1.08 * single


def test_command_leads_beyond_a_goal_to_the_next_one() -> None:
    loop = SampledLoop(START)
    follow(loop, POSES)
    loop.run(1.0)
    plan, after = loop.decision.plan, loop.decision.plan.hold.times > loop.decision.plan.end
    assert np.abs(plan.hold.speeds[after]).max() > 50.0
    # It passes the goal at rest, and is there what was asked for.
    end = plan.at(plan.end, loop.robot.lumped, loop.decision.disturbance)
    np.testing.assert_allclose(end[POSITION], POSES[0][POSITION], atol=1e-3)
    assert np.abs(plan.hold.at(plan.end)).max() < 1e-6
    assert plan.way_left(loop.time) < np.linalg.norm(POSES[0][POSITION]) + 0.5, "to that goal"
    run_to_the_end(loop)
    # Each goal is left as soon as it is reached: the sphere stands for no sample period there.
    speeds = np.max(np.abs(loop.speeds), axis=1)
    moving = speeds[: int(np.flatnonzero(speeds > 1.0)[-1])] > 1.0
    stands = np.diff(np.flatnonzero(np.concatenate(([True], moving, [True]))))
    assert stands.max() * loop.spacing < 0.2


@pytest.mark.parametrize("at", [1.0, 2.2, 4.0])
def test_pushed_sphere_is_led_to_each_goal_in_order(at) -> None:
    loop = SampledLoop(START)
    follow(loop, POSES)
    loop.run(at)
    loop.push_momentum(np.array([8.0, -6.0, 0.0]))
    run_to_the_end(loop)
    # The rotors hold the momentum at an orientation that differs from one that leans.
    assert are_visited(loop, [POSES[0], POSES[2], POSES[3]])


def test_goal_that_was_missed_is_returned_to() -> None:
    loop = SampledLoop(START)
    follow(loop, POSES[:2])
    loop.run(0.5)
    while loop.decision.plan.end - loop.time > 0.3:
        loop.run(0.25)
    # Off by some centimetres when it should be there, with the next leg already sent.
    loop.push_momentum(np.array([0.0, 25.0, 0.0]))
    loop.advance(0.2)
    loop.push_momentum(np.array([0.0, -25.0, 0.0]))
    began = run_to_the_end(loop)
    near = [one <= began[1] for one in np.array(loop.times)[loop.errors(POSES[0]) < REACHED]]
    assert any(near), "it was there before the next leg was followed"


def test_other_goals_replace_what_follows() -> None:
    loop = SampledLoop(START)
    follow(loop, POSES)
    loop.run(1.5)
    other = upright_state(0.3, -1.0, 1.0)
    follow(loop, [other])
    loop.keep_from_now_on()
    run_to_the_end(loop)
    assert are_visited(loop, [other])
    assert not are_visited(loop, [POSES[1]]) and loop.controller.active.is_last


def test_sphere_stops_on_its_path_with_the_next_leg_sent() -> None:
    loop = SampledLoop(START)
    follow(loop, POSES)
    loop.run(0.5)
    while loop.decision.plan.end - loop.time > 0.25:
        loop.run(0.25)
    path = loop.path()
    loop.controller.cancel()
    loop.keep_from_now_on()
    loop.run(2.0)
    off = [np.linalg.norm(path[:, POSITION] - one, axis=1).min() for one in loop.places[::20]]
    assert max(off) < 5e-3
    assert np.abs(loop.speeds[-1]).max() == 0.0
    loop.check_limits()


@pytest.mark.parametrize(
    ("walls", "goals"),
    [
        (DOORWAY, [pose(5.0, 2.0), pose(4.6, 3.2), pose(1.2, 1.0)]),
        # Only parts of the way are planned at first: their ends are no goals.
        ([(2.0, 0.8, 2.2, 4.0), (3.8, 0.0, 4.0, 3.0)], [pose(5.0, 3.0), pose(1.0, 3.2)]),
    ],
    ids=["doorway", "around two walls"],
)
def test_list_on_a_floor_keeps_clear(walls, goals) -> None:
    floor = floor_of(walls)
    loop = SampledLoop(pose(1.0, 2.0), floor=floor)
    follow(loop, goals)
    run_to_the_end(loop)
    assert are_visited(loop, goals)
    assert least_distance(floor, loop.places[::4]) > RADIUS
    told = [d.plan.clearance for d in loop.decisions if not d.plan.stops]
    assert min(told) >= 0.0


def test_refused_goal_in_a_list_is_not_skipped() -> None:
    loop = SampledLoop(pose(1.0, 2.0), floor=floor_of([(3.0, 1.0, 3.2, 3.0)]))
    follow(loop, [pose(1.4, 2.0), pose(3.1, 2.0), pose(1.0, 1.0)])
    loop.run(12.0)
    assert loop.controller.active.index == 1 and not loop.controller.at_goal
    assert loop.decision.plan.unreachable is Kind.GOAL_OCCUPIED


@pytest.mark.parametrize(
    "world", [DisturbanceSettings(slope=1e-3), DisturbanceSettings(mass_offset_x=2e-4)],
    ids=["slope", "out of balance"],
)
def test_list_is_visited_with_momentum(world) -> None:
    goals = [upright_state(1.0, 0.0, 0.5), upright_state(0.2, 0.6, 2.0)]
    loop = SampledLoop(START, world=world)
    follow(loop, goals)
    run_to_the_end(loop)
    assert are_visited(loop, goals)


@pytest.mark.parametrize("kind", [Orientation.ANY_HEADING, Orientation.ANY])
def test_list_of_sets_of_poses_is_visited(kind) -> None:
    loop = SampledLoop(START)
    follow(loop, POSES, kind)
    began = run_to_the_end(loop)
    assert len(began) == len(POSES)
    for goal in POSES:
        members = kind.nearest_of(goal, np.array(loop.states))
        errors = np.linalg.norm(np.array(loop.states)[:, POSITION] - members[:, POSITION], axis=1)
        assert errors.min() < REACHED


@pytest.mark.parametrize(
    "goals",
    [
        [START, START],
        [START, POSES[0], POSES[0], START],
        [upright_state(0.02, 0.0, 0.0), upright_state(0.04, 0.0, 0.0), START],
    ],
    ids=["where it is", "each twice", "two centimetres apart"],
)
def test_what_a_person_would_type_is_visited(goals) -> None:
    loop = SampledLoop(START)
    follow(loop, goals)
    loop.run(0.25)
    run_to_the_end(loop)
    assert are_visited(loop, goals)


def test_goals_count_as_reached_within_their_own_tolerance() -> None:
    loop = SampledLoop(START, replace(FAST, position_tolerance=0.2, orientation_tolerance=3.2))
    follow(loop, POSES)
    began = run_to_the_end(loop)
    assert len(began) == len(POSES)
    for goal, at in zip(POSES, began[1:], strict=False):
        place = loop.places[int(np.searchsorted(loop.times, at))]
        assert np.linalg.norm(place - goal[POSITION]) < 0.25


@pytest.mark.parametrize(
    ("end", "status", "index"),
    [
        (LegEnd.REST, PlanStatus.SOLVED, 1),
        (LegEnd.THROUGH, PlanStatus.SOLVED, 0),
        (LegEnd.REST, PlanStatus.BEST_SO_FAR, 0),
    ],
)
def test_end_of_a_plan_that_is_on_the_way_to_a_goal_is_not_that_goal(end, status, index) -> None:
    def planned(situation: Situation) -> Plan:
        leg = Leg(replace(situation.goal, since=situation.time + 0.1), end)
        return plan_of(situation, [0.1, 0.2], np.zeros((2, 2)), leg=leg, status=status)

    loop = SampledLoop(START, strategy=Given(planned))
    follow(loop, POSES)
    loop.run(0.5)  # as planned, past the time at which the plan has ended
    assert loop.controller.active.index == index
