# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loops on floors: goals are reached around what is occupied, or refused, untouched."""

import gc
import math
import weakref
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from floor_plans import (
    CLOSED,
    DOORWAY,
    RADIUS,
    SIDEWAYS,
    floor_of,
    least_distance,
    pose,
    rolled,
)
from given_plans import Given
from sampled_loop import SampledLoop

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.layers import Layers
from sphere_nmpc.floor.route import route_to
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.time_optimal.search_task import SearchTask
from sphere_sim.study.suite import PolicyStrategy

pytestmark = pytest.mark.slow

SETTINGS = ControllerSettings(planning_effort=20_000)
RATE_50 = replace(SETTINGS, control_rate=50.0)
LARGER = RobotParameters(shell_radius=1.15 * RADIUS)
"""The sphere with a shell that is 15 % larger."""
HERE, THERE = pose(1.0, 3.0), pose(4.5, 1.0)
"""On either side of the wall with a doorway."""
MAZE = [*DOORWAY, (1.8, 0.0, 1.9, 2.2)]


def rolling(
    walls: list[tuple[float, float, float, float]] | Floor | None = DOORWAY, start: Vector = HERE,
    goal: Vector = THERE, strategy: str | Given = "time_optimal", settings: Any = SETTINGS,
    **others: Any,
) -> SampledLoop:
    """Return a loop from rest to a goal on a floor."""
    floor = floor_of(walls) if isinstance(walls, list) else walls
    if isinstance(strategy, str):
        settings, strategy = replace(settings, strategy=strategy), None
    return SampledLoop(start, settings, floor=floor, goal=goal, strategy=strategy, **others)


def clearance(loop: SampledLoop, floor: Floor | None = None) -> float:
    """Return the least clearance of the places that a loop has kept [m]."""
    return least_distance(floor or loop.controller.floor, loop.places) - RADIUS


def searches(loop: SampledLoop) -> list[SearchTask]:
    return [task for task in loop.worker.tasks if isinstance(task, SearchTask)]


def test_through_a_doorway_with_the_clearance_that_is_told() -> None:
    loop = rolling(goal=pose(4.5, 1.0, SIDEWAYS))
    floor = loop.controller.floor
    (first,) = loop.run(SETTINGS.control_period)
    assert floor.clearance <= first.clearance < 1.0
    loop.run(15.0)
    assert loop.error() < 1e-2
    assert clearance(loop) >= floor.clearance
    assert loop.decision.plan.status is PlanStatus.HOLDING


def test_a_goal_near_a_wall_is_reached() -> None:
    """Nearer to it than the margin of a plan."""
    floor = floor_of([])
    loop = rolling(floor, pose(3.0, 2.0), pose(floor.needed + 1e-3, 2.0, SIDEWAYS))
    loop.run(12.0)
    assert loop.error() < 1e-2
    assert clearance(loop) >= floor.clearance - 1e-3


@pytest.mark.parametrize("goal", [RADIUS + 0.031, LARGER.shell_radius + 0.02])
def test_a_larger_sphere_is_never_rolled_into_a_wall(goal: float) -> None:
    """By 15 per cent, to a goal beside a wall that one as built may come to."""
    floor, radius = floor_of([], clearance=0.03), LARGER.shell_radius
    loop = rolling(floor, pose(3.0, 2.0), pose(goal, 2.0), robot=LARGER)
    loop.run(12.0)
    assert least_distance(floor, loop.places) >= radius
    if goal < radius:
        assert f"less than the radius that is learnt, {radius:.3g} m" in loop.given_up
    else:
        assert loop.error() < 1e-2
        assert not loop.given_up


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize(("x", "y", "kind", "reason"), [
    (3.05, 0.5, Kind.GOAL_OCCUPIED, "it is occupied"),
    (-1.0, 0.5, Kind.GOAL_OUTSIDE, "outside of the floor"),
    (0.31, 2.0, Kind.GOAL_OCCUPIED,
     "0.31 m from what is occupied, less than radius and clearance, 0.32 m"),
])
def test_goals_that_cannot_be_are_refused(
    x: float, y: float, kind: Kind, reason: str, strategy: str
) -> None:
    loop = rolling(goal=pose(x, y), strategy=strategy)
    loop.run(1.0)
    assert reason in loop.given_up
    assert loop.decision.plan.unreachable is kind
    assert not loop.has_moved


AREA = np.array([[3.5, -1.0], [5.5, -1.0], [5.5, 5.0], [3.5, 5.0]])


@pytest.mark.parametrize(
    ("walls", "start", "goal", "kind", "words"),
    [
        (DOORWAY, HERE, THERE, None, ""),  # in the area
        (DOORWAY, HERE, pose(3.05, 0.5), Kind.GOAL_OCCUPIED, ""),
        (CLOSED, HERE, pose(5.9, 1.0), Kind.GOAL_OCCUPIED, ""),  # too near the edge
        (DOORWAY, pose(4.5, 3.0), pose(1.0, 1.0), None, "place of the sphere"),
        (DOORWAY, pose(3.05, 0.5), pose(1.0, 1.0), Kind.START_OCCUPIED, "place of the sphere"),
    ],
)
def test_what_an_area_keeps_from_its_goal_may_reach_it_later(
    walls, start: Vector, goal: Vector, kind: Kind | None, words: str
) -> None:
    """Of what stands on the map itself no area changes anything."""
    floor = floor_of(walls)
    grid = Layers(map=floor.grid).with_keepout(1, AREA).grid(RADIUS)
    assert grid is not None
    loop = rolling(Floor(grid, RADIUS, floor.clearance), start, goal)
    loop.run(1.0)
    assert loop.given_up and words in loop.given_up
    assert loop.decision.plan.unreachable is kind


def test_a_goal_behind_a_wall_is_refused_until_there_is_a_door() -> None:
    loop = rolling(CLOSED)
    loop.run(3.0)
    assert "no way" in loop.given_up
    assert loop.decision.plan.unreachable is Kind.NO_WAY
    assert not loop.has_moved
    loop.controller.floor = floor_of(DOORWAY)
    loop.run(12.0)
    assert not loop.given_up
    assert loop.error() < 1e-2


def test_a_goal_after_one_without_a_way_is_not_held_up_by_searches_beside_the_loop() -> None:
    loop = rolling(CLOSED, settings=RATE_50, search_time=0.05)
    loop.run(1.1)
    assert "no way" in loop.given_up
    # Once a sample period, and not at each tick.
    assert 3 <= len(searches(loop)) <= 2 + 1.1 / RATE_50.period
    loop.controller.set_goal(pose(2.0, 1.0))
    loop.run(0.3)
    assert not loop.given_up
    assert loop.has_moved


@pytest.mark.parametrize("walls", [[], DOORWAY])
def test_a_goal_is_reached_while_the_floor_is_replaced_ten_times_a_second(
    walls: list[tuple[float, float, float, float]]
) -> None:
    """An area moves far from the way, and a search takes longer than its floor is in force."""
    loop = rolling(
        None, goal=pose(4.5, 1.0, SIDEWAYS), settings=RATE_50, search_time=0.25
    )
    floors = []
    gc.disable()
    try:
        for k in range(150):
            away = 0.05 * (k % 10)
            loop.controller.floor = floor_of([*walls, (5.0 + away, 3.5, 5.4 + away, 3.9)])
            floors.append(weakref.ref(loop.controller.floor))
            loop.worker.tasks.clear()
            loop.decisions.clear()
            loop.run(0.1)
            assert "no way" not in loop.given_up
        # In force, of a search under way, and of the last result; no garbage that keeps others.
        assert sum(floor() is not None for floor in floors) <= 4
    finally:
        gc.enable()
    assert loop.error() < 1e-2
    assert clearance(loop, floor_of(walls)) >= 0.02


def test_no_way_is_told_while_the_floor_is_replaced_and_searched_for_at_once_on_the_next() -> None:
    loop = rolling(None, settings=RATE_50, search_time=0.15)
    told = []
    for k in range(20):
        loop.controller.floor = floor_of([*CLOSED, (5.0 + 0.05 * (k % 10), 3.5, 5.6, 3.9)])
        loop.run(0.1)
        told.append("no way" in loop.given_up)
    # From the first search on, and without a break.
    assert not told[0] and all(told[4:])
    loop.controller.floor = floor_of(DOORWAY)
    # What is under way ends, and the next search finds a motion.
    loop.run(0.5)
    assert not loop.given_up
    assert loop.has_moved


def test_a_refused_goal_while_rolling_stops_on_the_path() -> None:
    loop = rolling()
    loop.run(2.0)
    moving = len(loop.states)
    loop.controller.set_goal(pose(3.05, 0.5))
    loop.run(2.0)
    assert "occupied" in loop.given_up
    rest = loop.places[moving + 150 :]
    assert (rest == rest[-1]).all()
    assert clearance(loop) >= loop.controller.floor.clearance
    loop.controller.set_goal(HERE)
    loop.run(8.0)
    assert loop.error(HERE) < 1e-2


def test_it_stops_before_a_new_obstacle_and_goes_around_or_tells_that_it_comes_too_late() -> None:
    for gap, walls in ((0.4, (1.5, 2.5)), (0.05, (1.0, 3.0))):
        loop = rolling([], pose(1.0, 2.0), pose(5.0, 2.0))
        loop.run(2.0)
        loop.keep_from_now_on()
        ahead = math.ceil(20.0 * (loop.pose[0] + RADIUS + gap) - 1e-9) / 20.0
        loop.controller.floor = floor_of([(ahead, walls[0], ahead + 0.1, walls[1])])
        loop.run(SETTINGS.control_period)
        if gap < 0.1:
            assert "a stop without contact: it takes 0." in loop.given_up
            assert "m are free" in loop.given_up
        else:
            loop.run(14.0)
            assert clearance(loop) >= 0.0
            assert loop.error() < 1e-2


def test_a_start_without_clearance_leaves_without_coming_nearer() -> None:
    loop = rolling(start=pose(RADIUS + 0.005, 3.0), goal=pose(1.0, 1.0))
    loop.run(12.0)
    assert loop.error() < 1e-2
    floor = loop.controller.floor
    distances = np.array([floor.distance(place) for place in loop.places])
    short = distances < floor.needed
    first = int(np.argmin(short))
    assert first > 0 and not short[first:].any()
    # The certificate knows distances to within a millimetre there.
    assert (distances[:first] >= np.maximum.accumulate(distances[:first]) - 2e-3).all()


@pytest.mark.parametrize("strategy", ["paper", "plan_keeping"])
def test_strategies_that_know_no_floor_stop_before_it(strategy: str) -> None:
    loop = rolling(CLOSED, pose(2.0, 2.0), pose(4.0, 2.0), strategy)
    loop.run(6.0)
    assert strategy in loop.given_up
    assert clearance(loop) >= 0.0
    loop.controller.set_goal(pose(1.5, 1.5))
    loop.run(6.0)
    assert not loop.given_up
    assert np.linalg.norm(loop.places[-1] - (1.5, 1.5)) < 0.1


def test_a_floor_far_away_changes_no_refusal_and_no_floor_changes_nothing() -> None:
    """Two loops, one of which is given a floor and loses it again before it has a goal."""
    found = []
    for walls in (None, []):
        loop = rolling(walls, pose(1.0, 1.0), pose(1.0, 1.0))
        loop.controller.cancel()
        loop.run(0.5)
        loop.controller.floor = None
        loop.controller.set_goal(pose(2.0, 2.0, SIDEWAYS))
        loop.run(3.0)
        assert not math.isfinite(loop.decision.plan.clearance)
        found.append(np.array(loop.states))
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("goal", [pose(5.0, 2.0), pose(3.0, 2.0)])
def test_it_stops_inside_of_an_area_that_is_dropped_over_it(strategy: str, goal: Vector) -> None:
    """Also where the goal is in it; there every distance is 0, so that none falls."""
    loop = rolling([], pose(1.0, 2.0), goal, strategy)
    loop.run(1.5)
    loop.controller.floor = area = floor_of([(0.5, 0.5, 4.0, 3.5)])
    loop.sample()
    stop = float(np.linalg.norm(np.diff(loop.path()[:, POSITION], axis=0), axis=1).sum())
    loop.keep_from_now_on()
    loop.run(4.0)
    way = np.linalg.norm(np.diff(loop.places, axis=0), axis=1).sum()
    assert way <= stop + 1e-3
    assert stop < 0.3
    assert "the place of the sphere is occupied" in loop.given_up
    # It goes on when the area is gone.
    assert area.is_occupied(loop.pose[POSITION])
    loop.controller.floor = floor_of([])
    loop.run(0.5)
    assert not loop.given_up


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_goal_in_an_area_is_not_reached_though_the_sphere_is_there(strategy: str) -> None:
    loop = rolling([], pose(1.0, 2.0), pose(1.0, 2.0), strategy)
    loop.run(1.0)
    assert loop.decision.mode is Kind.AT_GOAL
    loop.controller.floor = floor_of([(0.5, 1.5, 1.5, 2.5)])
    loop.run(1.0)
    assert not loop.controller.at_goal
    assert loop.decision.mode is Kind.TRACKING
    assert "occupied" in loop.given_up


def test_a_command_that_begins_late_is_certified_as_it_is_sent() -> None:
    """Each is sent 0.1 s late: what it leads to keeps clear from the state in which it begins."""
    loop = rolling(delay=0.1)
    least, floor = math.inf, loop.controller.floor
    for _ in range(160):  # a last ramp that is sent late may end beside the goal
        loop.sample()
        least = min(least, least_distance(floor, loop.path()[::5, POSITION]))
        loop.advance(loop.settings.control_period - loop.delay)
        if loop.error() < 1e-2:
            break
    assert least >= floor.needed - 1e-4
    assert loop.error() < 1e-2


def test_parts_of_a_way_lead_on_from_where_the_sphere_has_last_rested() -> None:
    """By a tenth of the radius, so that there are finitely many rests."""
    loop = rolling(MAZE, pose(1.0, 1.0), search_time=0.05)
    loop.run(16.0)
    assert loop.error() < 1e-2
    way = route_to(loop.controller.floor, THERE[POSITION])
    tasks = [task for task in searches(loop) if task.rested is not None]
    left = [way.length(task.rested) for task in tasks]
    assert len(left) > 5
    falls = -np.diff(left)
    assert ((falls == 0.0) | (falls > 0.1 * RADIUS - 2e-3)).all()
    # Nothing does from beside the goal.
    assert isinstance(tasks[0](), Plan)
    assert replace(tasks[0], rested=THERE[POSITION] + 0.05)() == ""


def along_x(way: float, status: PlanStatus = PlanStatus.SOLVED) -> Given:
    """Return a strategy that always plans to roll by a way along x [m]."""
    return Given(lambda now: Plan(
        rolled(way).delayed(now.time), np.vstack((now.state, now.state)), status
    ))


@pytest.mark.parametrize("status", [s for s in PlanStatus if s is not PlanStatus.RAMP_TO_REST])
def test_no_plan_of_any_status_leads_into_a_wall(status: PlanStatus) -> None:
    loop = rolling(CLOSED, pose(2.0, 2.0), pose(1.0, 2.0), along_x(1.0, status))
    loop.run(4.0)
    assert least_distance(loop.controller.floor, loop.places) >= loop.controller.floor.needed
    assert not loop.controller.failures


def test_a_failing_strategy_stops_before_a_new_obstacle() -> None:
    strategy = along_x(1.5)
    loop = rolling([], pose(1.0, 2.0), pose(5.0, 2.0), strategy)
    loop.sample()
    loop.advance(0.05)
    loop.controller.floor = floor_of([(1.5, 0.0, 1.6, 4.0)])
    strategy.make = None
    loop.run(2.0)
    assert loop.controller.failures
    assert clearance(loop) > 0.0


@pytest.mark.parametrize("start", [1.0, 1.1, 1.2, 1.3])
def test_plan_that_ends_in_motion_is_certified_with_the_stop_that_is_sent_with_it(start) -> None:
    floor, settings = floor_of(CLOSED), ControllerSettings(sample_period=0.5)
    policy = PolicyStrategy(lambda now: [0.0, -90.0], settings, RobotParameters())
    here, goal = pose(start, 2.0), pose(2.0, 2.0)
    loop = SampledLoop(here, settings, goal=goal, floor=floor, strategy=policy)
    loop.run(6.0)
    assert loop.places[-1, 0] > start + 0.2
    assert least_distance(floor, loop.places) > RADIUS + floor.clearance - 1e-6
