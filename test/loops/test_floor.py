# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plans among obstacles: their certificate, straight lines, and the closed loop on floors."""

import gc
import itertools
import math
import weakref
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from floor_plans import DOORWAY, RADIUS, floor_of, least_distance, pose
from sampled_loop import ROBOT, SampledLoop

from sphere_nmpc.conditions import Kind
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.layers import Layers
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model import rotation
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import (
    POSITION,
    QUATERNION,
    Vector,
    state_error,
    without_momentum,
)
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.clearance import (
    Margin,
    certified,
    clearance_of,
    plain_certified,
    profile_of,
)
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import PlanStatus
from sphere_nmpc.strategy.time_optimal.background import SearchTask, solver_for
from sphere_nmpc.strategy.time_optimal.lines import line_hold, speeds_along
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

pytestmark = pytest.mark.slow

SOLVER = solver_for(ROBOT, TimeOptimalSettings())
LEVEL = (1.0, 0.0, 0.0, 0.0)
SIDEWAYS = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)
SETTINGS = ControllerSettings(planning_effort=20_000)


RATE_50 = replace(SETTINGS, control_rate=50.0)


def rolling(floor: Floor | None, start: Vector, goal: Vector, **others: Any) -> SampledLoop:
    """Return a loop from rest to a goal on a floor."""
    return SampledLoop(start, others.pop("settings", SETTINGS), floor=floor, goal=goal, **others)


def clearance(floor: Floor, places: Vector) -> float:
    return least_distance(floor, places) - RADIUS


def tilted(z_vertical: float, rng: np.random.Generator) -> Vector:
    """Return an orientation whose body's z axis has this vertical component."""
    turn = rotation.exponential(np.array((math.acos(z_vertical), 0.0, 0.0)))
    about = [rotation.exponential(np.array((0.0, 0.0, a))) for a in rng.uniform(-3.0, 3.0, 2)]
    return rotation.product(about[0], rotation.product(turn, about[1]))


@pytest.mark.parametrize("vertical", [None, 0.1, 0.0068, -0.004, 0.0])
def test_straight_lines_from_any_orientation(vertical: float | None) -> None:
    """The path of the model leaves the line by 3 mm at the most, and by 1 mm in the median."""
    rng, across = np.random.default_rng(0), []
    for _ in range(40 if vertical is None else 10):
        turn = rotation.random_quaternion(rng) if vertical is None else tilted(vertical, rng)
        state = without_momentum(pose(0.0, 0.0, tuple(turn)))
        target = rng.uniform(-1.5, 1.5, 2)
        hold = line_hold(state, target, ROBOT.lumped, SOLVER)
        assert hold is not None and not hold.speeds[[0, -1]].any()
        assert np.abs(hold.speeds).max() <= ROBOT.max_rotor_speed
        slopes = np.diff(hold.speeds, axis=0) / np.diff(hold.times)[:, None]
        assert np.abs(slopes).max() <= ROBOT.max_rotor_acceleration
        times = np.linspace(0.0, hold.end, 500)
        path = roll_out(
            state, hold.resampled(times).speeds, np.diff(times), ROBOT.lumped.as_array()
        )[:, POSITION]
        along = target / np.linalg.norm(target)
        across.append(np.abs(path @ np.array((-along[1], along[0]))).max())
        assert np.linalg.norm(path[-1] - target) < 3e-3
    assert max(across) < 3e-3 and np.median(across) < 1e-3


def test_the_constant_of_a_line_is_kept_up_to_the_circle() -> None:
    """That of the motion that the rotor speeds lead to, integrated in finite steps."""
    rng, power = np.random.default_rng(3), 1.0 / (1.0 - ROBOT.lumped.axial_ratio)
    for _ in range(5):
        turn, heading = tilted(0.4, rng), rng.uniform(-3.0, 3.0)
        direction = np.array((math.cos(heading), math.sin(heading)))
        axis = np.array((-direction[1], direction[0], 0.0))
        at, speeds = speeds_along(turn, direction, 3.0, ROBOT.lumped)
        state = without_momentum(pose(0.0, 0.0, tuple(turn)))
        states = roll_out(state, speeds, np.diff(at), ROBOT.lumped.as_array())
        z = np.array([rotation.matrix(q)[:, 2] for q in states[:, QUATERNION]])
        before = np.minimum.accumulate(z[:, 2]) > 0.0
        constant = z[0] @ axis / z[0, 2] ** power
        expected = np.where(before, constant * np.abs(z[:, 2]) ** power, 0.0)
        np.testing.assert_allclose(z @ axis, expected, atol=1e-3)
        np.testing.assert_allclose(states[-1, POSITION], 3.0 * RADIUS * direction, atol=1e-3)


def test_the_certificate_bounds_the_clearance_of_the_motion() -> None:
    rng = np.random.default_rng(1)
    floor = floor_of([(2.0, 2.0, 2.5, 2.3), (4.0, 0.5, 4.1, 3.0)])
    count = 0
    for _ in range(120):
        place = rng.uniform((0.5, 0.5), (5.5, 3.5))
        state = without_momentum(pose(*place, tuple(rotation.random_quaternion(rng))))
        times = np.cumsum(rng.uniform(0.05, 0.5, 5)) - 0.05
        times[0] = 0.0
        speeds = rng.uniform(-100.0, 100.0, (5, 2))
        hold = FirstOrderHold(times, speeds)
        situation = Situation(
            0.0, state, pose(1.0, 1.0), np.zeros(2), ROBOT.lumped, floor=floor
        )
        found = clearance_of(situation, hold, Margin.FOUND)
        fine = np.linspace(0.0, hold.end, 400)
        path = roll_out(
            state, hold.resampled(fine).speeds, np.diff(fine), ROBOT.lumped.as_array()
        )[:, POSITION]
        exact = clearance(floor, path)
        if math.isnan(found):
            # Short by no more than the steps of the map and of the samples can explain.
            allowed = floor.clearance + Margin.FOUND.value * RADIUS
            start = floor.distances(place[None, :])[0] - RADIUS
            assert exact < allowed + 0.03 or start < allowed
            continue
        count += 1
        if floor.distance(place) > floor.needed + 0.02:
            assert exact >= min(found, 0.69) - 1e-6
            assert found >= floor.clearance
    assert count > 20


def test_samples_are_no_farther_apart_than_their_bound() -> None:
    rng = np.random.default_rng(2)
    state = without_momentum(pose(0.0, 0.0))
    hold = FirstOrderHold(np.array([0.0, 0.4, 0.5, 1.1]), rng.uniform(-100, 100, (4, 2)))
    situation = Situation(0.0, state, pose(1.0, 1.0), np.zeros(2), ROBOT.lumped)
    path, _, lengths = profile_of(situation, hold, 0.005)
    assert (np.linalg.norm(np.diff(path, axis=0), axis=1) <= lengths + 1e-12).all()
    assert len(path) == lengths.size + 1
    # To the end of the hold, whatever the sampling.
    coarse = profile_of(situation, hold, 0.04).places
    np.testing.assert_allclose(coarse[-1], path[-1], atol=1e-6)


@pytest.mark.parametrize("turn", [LEVEL, SIDEWAYS])
def test_through_a_doorway(turn: tuple[float, ...]) -> None:
    floor = floor_of(DOORWAY)
    goal = pose(4.5, 1.0, turn)
    loop = rolling(floor, pose(1.0, 3.0), goal)
    loop.run(15.0)
    assert state_error(loop.states[-1], goal) < 1e-2
    assert clearance(floor, loop.places) >= floor.clearance
    assert loop.decision.plan.status is PlanStatus.HOLDING


def test_a_goal_near_a_wall_is_reached() -> None:
    """Nearer to it than the margin of a plan."""
    floor = floor_of([])
    goal = pose(floor.needed + 1e-3, 2.0, SIDEWAYS)
    loop = rolling(floor, pose(3.0, 2.0), goal)
    loop.run(12.0)
    assert state_error(loop.states[-1], goal) < 1e-2
    assert clearance(floor, loop.places) >= floor.clearance - 1e-3


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
    settings = ControllerSettings(strategy=strategy)
    loop = rolling(floor_of(DOORWAY), pose(1.0, 3.0), pose(x, y), settings=settings)
    loop.run(1.0)
    assert reason in loop.given_up
    assert loop.decision.plan.unreachable is kind
    assert not loop.has_moved


def with_area(floor: Floor, area: Vector) -> Floor:
    """Return a floor with an area to keep out of."""
    grid = Layers(map=floor.grid).with_keepout(1, area).grid(RADIUS)
    assert grid is not None
    return Floor(grid, RADIUS, floor.clearance)


def test_what_an_area_keeps_from_its_goal_may_reach_it_later() -> None:
    """Of what stands on the map itself no area changes anything."""
    area = np.array([[3.5, -1.0], [5.5, -1.0], [5.5, 5.0], [3.5, 5.0]])
    for walls, goal, kind in (
        (DOORWAY, pose(4.5, 1.0), None),  # in the area
        (DOORWAY, pose(3.05, 0.5), Kind.GOAL_OCCUPIED),
        ([(3.0, 0.0, 3.1, 4.0)], pose(5.9, 1.0), Kind.GOAL_OCCUPIED),  # too near the edge
    ):
        loop = rolling(with_area(floor_of(walls), area), pose(1.0, 3.0), goal)
        loop.run(1.0)
        assert loop.given_up and loop.decision.plan.unreachable is kind
    loop = rolling(with_area(floor_of(DOORWAY), area), pose(4.5, 3.0), pose(1.0, 1.0))
    loop.run(0.5)
    assert "place of the sphere" in loop.given_up and loop.decision.plan.unreachable is None
    loop = rolling(floor_of(DOORWAY), pose(3.05, 0.5), pose(1.0, 1.0))
    loop.run(0.5)
    assert loop.decision.plan.unreachable is Kind.START_OCCUPIED


def test_a_goal_behind_a_wall_is_refused_until_there_is_a_door() -> None:
    closed = floor_of([(3.0, 0.0, 3.1, 4.0)])
    goal = pose(4.5, 1.0)
    loop = rolling(closed, pose(1.0, 3.0), goal)
    loop.run(3.0)
    assert "no way" in loop.given_up
    assert loop.decision.plan.unreachable is Kind.NO_WAY
    assert not loop.has_moved
    loop.controller.floor = floor_of(DOORWAY)
    loop.run(12.0)
    assert not loop.given_up
    assert state_error(loop.states[-1], goal) < 1e-2


def test_a_goal_after_one_without_a_way_is_not_held_up_by_searches_beside_the_loop() -> None:
    closed = floor_of([(3.0, 0.0, 3.1, 4.0)])
    loop = rolling(
        closed, pose(1.0, 3.0), pose(4.5, 1.0), settings=RATE_50, search_time=0.05
    )
    loop.run(1.1)
    assert "no way" in loop.given_up
    # Once a sample period, and not at each tick.
    searches = [task for task in loop.worker.tasks if isinstance(task, SearchTask)]
    assert 3 <= len(searches) <= 2 + 1.1 / RATE_50.period
    loop.controller.set_goal(pose(2.0, 1.0))
    loop.run(0.3)
    assert not loop.given_up
    assert loop.has_moved


@pytest.mark.parametrize("walls", [[], DOORWAY])
def test_a_goal_is_reached_while_the_floor_is_replaced_ten_times_a_second(
    walls: list[tuple[float, float, float, float]]
) -> None:
    """An area moves far from the way, and a search takes longer than its floor is in force."""
    goal = pose(4.5, 1.0, SIDEWAYS)
    loop = rolling(None, pose(1.0, 3.0), goal, settings=RATE_50, search_time=0.25)
    floors = []
    gc.disable()
    try:
        for k in range(150):
            away = 0.05 * (k % 10)
            loop.controller.floor = floor_of([*walls, (5.0 + away, 3.5, 5.4 + away, 3.9)])
            floors.append(weakref.ref(loop.controller.floor))
            loop.worker.tasks.clear()
            loop.run(0.1)
            assert "no way" not in loop.given_up
        # In force, of a search under way, and of the last result; no garbage that keeps others.
        assert sum(floor() is not None for floor in floors) <= 4
    finally:
        gc.enable()
    assert state_error(loop.states[-1], goal) < 1e-2
    assert clearance(floor_of(walls), loop.places) >= 0.02


def test_no_way_is_told_while_the_floor_is_replaced_and_searched_for_at_once_on_the_next() -> None:
    loop = rolling(None, pose(1.0, 3.0), pose(4.5, 1.0), settings=RATE_50, search_time=0.15)
    told = []
    for k in range(20):
        closed = [(3.0, 0.0, 3.1, 4.0), (5.0 + 0.05 * (k % 10), 3.5, 5.6, 3.9)]
        loop.controller.floor = floor_of(closed)
        loop.run(0.1)
        told.append("no way" in loop.given_up)
    # From the first search on, and without a break.
    assert not any(told[:1])
    assert all(told[4:])
    loop.controller.floor = floor_of(DOORWAY)
    # What is under way ends, and the next search finds a motion.
    loop.run(0.5)
    assert not loop.given_up
    assert loop.has_moved


def test_a_refused_goal_while_rolling_stops_on_the_path() -> None:
    floor = floor_of(DOORWAY)
    loop = rolling(floor, pose(1.0, 3.0), pose(4.5, 1.0))
    loop.run(2.0)
    moving = len(loop.states)
    loop.controller.set_goal(pose(3.05, 0.5))
    loop.run(2.0)
    assert "occupied" in loop.given_up
    rest = loop.places[moving + 150 :]
    assert (rest == rest[-1]).all()
    assert clearance(floor, loop.places) >= floor.clearance
    loop.controller.set_goal(pose(1.0, 3.0))
    loop.run(8.0)
    assert state_error(loop.states[-1], pose(1.0, 3.0)) < 1e-2


def test_it_stops_before_a_new_obstacle_and_goes_around() -> None:
    free = floor_of([])
    goal = pose(5.0, 2.0)
    loop = rolling(free, pose(1.0, 2.0), goal)
    loop.run(2.0)
    ahead = math.ceil(20.0 * (loop.places[-1, 0] + RADIUS + 0.4)) / 20.0
    blocked = floor_of([(ahead, 1.5, ahead + 0.1, 2.5)])
    loop.controller.floor = blocked
    seen = len(loop.states)
    loop.run(14.0)
    assert clearance(blocked, loop.places[seen:]) >= 0.0
    assert state_error(loop.states[-1], goal) < 1e-2


def test_a_stop_that_comes_too_late_is_told_with_both_distances() -> None:
    loop = rolling(floor_of([]), pose(1.0, 2.0), pose(5.0, 2.0))
    loop.run(2.0)
    ahead = math.ceil(20.0 * (loop.places[-1, 0] + RADIUS)) / 20.0 + 0.05
    loop.controller.floor = floor_of([(ahead, 1.0, ahead + 0.1, 3.0)])
    loop.run(SETTINGS.control_period)
    assert "a stop without contact: it takes 0." in loop.given_up
    assert "m are free" in loop.given_up


def test_a_start_without_clearance_leaves_without_coming_nearer() -> None:
    floor = floor_of(DOORWAY)
    goal = pose(1.0, 1.0)
    loop = rolling(floor, pose(RADIUS + 0.005, 3.0), goal)
    loop.run(12.0)
    assert state_error(loop.states[-1], goal) < 1e-2
    distances = np.array([floor.distance(place) for place in loop.places])
    short = distances < floor.needed
    first = int(np.argmin(short))
    assert first > 0
    # The certificate knows distances to within a millimetre there.
    assert np.maximum.accumulate(distances[:first]).max() - distances[:first].min() < floor.needed
    assert (np.diff(np.maximum.accumulate(distances[:first])) >= 0.0).all()
    assert (distances[:first] >= np.maximum.accumulate(distances[:first]) - 2e-3).all()
    assert not short[first:].any()


def test_a_plan_tells_its_clearance() -> None:
    floor = floor_of(DOORWAY)
    loop = rolling(floor, pose(1.0, 3.0), pose(4.5, 1.0))
    loop.run(SETTINGS.control_period)
    plan = loop.decision.plan
    assert floor.clearance <= plan.clearance < 1.0
    free = rolling(None, pose(1.0, 3.0), pose(4.5, 1.0))
    free.run(SETTINGS.control_period)
    assert not math.isfinite(free.decision.plan.clearance)


@pytest.mark.parametrize("strategy", ["paper", "plan_keeping"])
def test_strategies_that_know_no_floor_stop_before_it(strategy: str) -> None:
    floor = floor_of([(3.0, 0.0, 3.1, 4.0)])
    settings = ControllerSettings(strategy=strategy)
    loop = rolling(floor, pose(2.0, 2.0), pose(4.0, 2.0), settings=settings)
    loop.run(6.0)
    assert strategy in loop.given_up
    assert clearance(floor, loop.places) >= 0.0
    loop.controller.set_goal(pose(1.5, 1.5))
    loop.run(6.0)
    assert not loop.given_up
    assert np.linalg.norm(loop.places[-1] - (1.5, 1.5)) < 0.1


def test_a_floor_far_away_changes_no_refusal_and_no_floor_changes_nothing() -> None:
    """Two loops, one of which is given a floor and loses it again before it has a goal."""
    found = []
    for floor in (None, floor_of([])):
        loop = rolling(floor, pose(1.0, 1.0), pose(1.0, 1.0))
        loop.controller.cancel()
        loop.run(0.5)
        loop.controller.floor = None
        loop.controller.set_goal(pose(2.0, 2.0, SIDEWAYS))
        loop.run(3.0)
        found.append(np.array(loop.states))
    for first, second in itertools.pairwise(found):
        np.testing.assert_array_equal(first, second)


def test_the_compiled_certificate_is_the_plain_one() -> None:
    rng = np.random.default_rng(3)
    walls = floor_of([(2.0, 2.0, 2.5, 2.3), (4.0, 0.5, 4.1, 3.0)])
    turned = Floor(Grid(walls.grid.occupied, 0.05, (0.3, -0.2, 0.4)), RADIUS, 0.02)
    found = []
    for k in range(200):
        floor = (walls, turned)[k % 2]
        place = floor.grid.world(rng.uniform((4, 4), (116, 76)))
        state = without_momentum(pose(*place, tuple(rotation.random_quaternion(rng))))
        state[6:] = (0.0, rng.normal())[k % 3 == 0] * rng.normal(size=3)
        times = np.cumsum(rng.uniform(0.05, 0.5, 5)) - 0.05
        hold = FirstOrderHold(times - times[0], rng.uniform(-60.0, 60.0, (5, 2)))
        situation = Situation(0.0, state, state[:6], np.zeros(2), ROBOT.lumped, floor=floor)
        compiled = certified(situation, hold, floor.needed)
        plain = plain_certified(situation, hold, floor.needed)
        np.testing.assert_allclose(compiled, plain, rtol=1e-9)
        found.append(compiled)
    assert 40 < np.isnan(found).sum() < 160
