# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Premises of the certificate of a plan: a free place, one radius, bounds that hold, no delay."""

import math
from dataclasses import replace

import numpy as np
import pytest
from floor_plans import DOORWAY, RADIUS, floor_of, least_distance, pose
from sampled_loop import ROBOT, SampledLoop

from sphere_nmpc.conditions import Kind
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.floor.route import route_to
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY, Disturbance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, Vector, state_error, without_momentum
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.strategy.clearance import (
    Margin,
    certified,
    clearance_of,
    needed_distance,
    plain_certified,
    profile_of,
    refusal,
    stop_before_contact,
)
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.time_optimal.background import SearchTask

pytestmark = pytest.mark.slow

SETTINGS = ControllerSettings(planning_effort=20_000)
LARGER = RobotParameters(shell_radius=1.15 * RADIUS)
"""The sphere with a shell that is 15 % larger."""


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("goal", [pose(5.0, 2.0), pose(3.0, 2.0)])
def test_it_stops_inside_of_an_area_that_is_dropped_over_it(strategy: str, goal: Vector) -> None:
    """Also where the goal is in it; there every distance is 0, so that none falls."""
    settings = replace(SETTINGS, strategy=strategy)
    loop = SampledLoop(pose(1.0, 2.0), settings, floor=floor_of([]), goal=goal)
    loop.run(1.5)
    loop.controller.floor = area = floor_of([(0.5, 0.5, 4.0, 3.5)])
    loop.sample()
    stop = float(np.linalg.norm(np.diff(loop.path()[:, POSITION], axis=0), axis=1).sum())
    begins = len(loop.states)
    loop.run(4.0)
    way = np.linalg.norm(np.diff(loop.places[begins:], axis=0), axis=1).sum()
    assert way <= stop + 1e-3
    assert stop < 0.3
    assert "the place of the sphere is occupied" in loop.decision.plan.given_up
    # It goes on when the area is gone.
    assert area.is_occupied(loop.pose[POSITION])
    loop.controller.floor = floor_of([])
    loop.run(0.5)
    assert not loop.decision.plan.given_up


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_goal_in_an_area_is_not_reached_though_the_sphere_is_there(strategy: str) -> None:
    settings, goal = replace(SETTINGS, strategy=strategy), pose(1.0, 2.0)
    loop = SampledLoop(goal, settings, floor=floor_of([]), goal=goal)
    loop.run(1.0)
    assert loop.decision.mode is Kind.AT_GOAL
    loop.controller.floor = floor_of([(0.5, 1.5, 1.5, 2.5)])
    loop.run(1.0)
    assert not loop.controller.at_goal
    assert loop.decision.mode is Kind.TRACKING
    assert "occupied" in loop.decision.plan.given_up


def on_a_line(distance: float) -> Situation:
    """Situation at a distance [m] from the wall of a floor, on a line where bounds are exact."""
    floor = floor_of([(3.0, 0.0, 3.1, 4.0)])
    state = without_momentum(pose(3.0 - distance, 2.0, (1.0, 0.0, 0.0, 0.0)))
    return Situation(0.0, state, pose(1.0, 2.0), np.zeros(2), ROBOT.lumped, floor=floor)


def rolled(way: float, back: bool = True) -> FirstOrderHold:
    """Hold that rolls the sphere by a way along x [m], and back and beyond if asked for."""
    rate = ROBOT.shell_radius * ROBOT.lumped.input_gain
    step = max(0.1, abs(way) / (80.0 * rate))
    speed = -way / (step * rate)
    speeds = [0.0, speed, 0.0, *((-speed, -4.0 * speed, 0.0) if back else ())]
    return FirstOrderHold(
        step * np.arange(len(speeds)), np.column_stack((np.zeros(len(speeds)), speeds))
    )


def both(situation: Situation, hold: FirstOrderHold) -> float:
    """The distance that is certified, which both certificates have to agree on."""
    assert situation.floor is not None
    needed = needed_distance(situation, Margin.KEPT)
    found = certified(situation, hold, needed)
    plain = plain_certified(situation, hold, needed)
    np.testing.assert_allclose(found, plain, rtol=1e-9)
    return found


@pytest.mark.parametrize("distance", [-0.05, 0.0, 0.4e-3, 0.9e-3])
def test_no_motion_leads_into_or_on_inside_of_what_is_occupied(distance: float) -> None:
    """Also from less than the decrease before it that counts as none."""
    situation = on_a_line(distance)
    assert math.isnan(both(situation, rolled(0.3, back=False)))


@pytest.mark.parametrize("beyond", [0.1e-3, 0.6e-3, 1.3e-3])
def test_a_start_without_clearance_is_not_certified_into_a_contact(beyond: float) -> None:
    """A fall of 1 mm counted as none, and where it was short nothing bound the path between."""
    situation = on_a_line(RADIUS + beyond)
    toward = rolled(beyond + 0.2e-3)
    assert profile_of(situation, toward, 1e-3).distances.min() < RADIUS
    assert math.isnan(both(situation, toward))
    assert both(situation, rolled(-0.02, back=False)) > RADIUS - 1e-9


def other_robots() -> list[RobotParameters]:
    """Robots with It2 < It1, and with It2 > It1."""
    small = RobotParameters(shell_radius=0.1, rotor_offset=0.05, shell_inertia=0.06 / 9.0)
    assert small.axial_inertia < small.transverse_inertia
    return [ROBOT, small]


@pytest.mark.parametrize("robot", other_robots())
def test_the_bound_of_the_way_holds_with_momentum_and_imbalance(robot: RobotParameters) -> None:
    rng, constants = np.random.default_rng(5), robot.lumped
    # Of a centre of mass that is beside the centre by 3 per cent of the radius.
    most = 0.03 * GRAVITY * constants.transverse_ratio / (
        constants.input_gain * constants.shell_radius
    )
    closest = 0.0
    for k in range(400):
        state = without_momentum(pose(0.0, 0.0, tuple(rotation.random_quaternion(rng))))
        z = rotation.matrix(state[2:6])[:, 2]
        state[6:] = 60.0 * (z if k % 2 else rng.normal(size=3))
        centre = rng.normal(size=3)
        disturbance = Disturbance(imbalance=most * centre / np.linalg.norm(centre))
        speeds = rng.uniform(-100.0, 100.0, 2) * (k % 3 > 0)
        hold = FirstOrderHold(np.array([0.0, 0.02]), np.vstack((speeds, speeds)))
        situation = Situation(
            0.0, state, pose(1.0, 1.0), np.zeros(2), constants, disturbance=disturbance
        )
        path, _, lengths = profile_of(situation, hold, 1e-3)
        ways = np.linalg.norm(np.diff(path, axis=0), axis=1)
        assert (ways <= lengths + 1e-9).all()
        closest = max(closest, float((ways / lengths).max()))
    assert closest > 0.85


@pytest.mark.parametrize("goal", [RADIUS + 0.031, LARGER.shell_radius + 0.02])
def test_a_larger_sphere_is_never_rolled_into_a_wall(goal: float) -> None:
    """By 15 per cent, to a goal beside a wall that one as built may come to."""
    floor = floor_of([], clearance=0.03)
    loop = SampledLoop(pose(3.0, 2.0), SETTINGS, LARGER, floor=floor, goal=pose(goal, 2.0))
    loop.run(12.0)
    radius = LARGER.shell_radius
    assert least_distance(floor, loop.places) >= radius
    plan = loop.decision.plan
    if goal < radius:
        assert f"less than the radius that is learnt, {radius:.3g} m" in plan.given_up
    else:
        assert state_error(loop.pose, pose(goal, 2.0)) < 1e-2
        assert not plan.given_up


def test_one_radius_is_asked_for_everywhere() -> None:
    situation = on_a_line(0.8)
    floor = situation.floor
    assert floor is not None
    larger = replace(situation, constants=replace(ROBOT.lumped, shell_radius=0.36))
    smaller = replace(situation, constants=replace(ROBOT.lumped, shell_radius=0.2))
    assert (larger.radius, smaller.radius) == (0.36, RADIUS)
    assert (larger.least_distance, smaller.least_distance) == (0.36, floor.needed)
    assert needed_distance(larger, Margin.SENT) == 0.36
    still = FirstOrderHold(np.array([0.0, 1.0]), np.zeros((2, 2)))
    apart = clearance_of(situation, still, Margin.KEPT) - clearance_of(larger, still, Margin.KEPT)
    assert apart == pytest.approx(0.06)
    touching = rolled(0.8 - 0.33, back=False)
    assert not stop_before_contact(situation, touching)
    assert stop_before_contact(larger, rolled((0.8 - 0.33) * RADIUS / 0.36, back=False))


@pytest.mark.parametrize("clearance", [0.0, 0.03])
def test_a_goal_at_just_the_distance_is_not_refused_as_the_learnt_radius_varies(
    clearance: float,
) -> None:
    floor = floor_of([], clearance)
    goal = pose(floor.needed, 2.0)
    for learnt in RADIUS + 1e-3 * np.linspace(-0.5, 0.5, 11):
        constants = replace(ROBOT.lumped, shell_radius=float(learnt))
        situation = Situation(
            0.0, without_momentum(pose(3.0, 2.0)), goal, np.zeros(2), constants, floor=floor
        )
        assert refusal(situation, floor) is None


def test_a_command_that_begins_late_is_certified_as_it_is_sent() -> None:
    """Each is sent 0.1 s late: what it leads to keeps clear from the state in which it begins."""
    floor = floor_of([*DOORWAY, (1.8, 0.0, 1.9, 2.2)])
    loop = SampledLoop(pose(1.0, 1.0), SETTINGS, delay=0.1, floor=floor, goal=pose(4.5, 1.0))
    least = math.inf
    for _ in range(80):
        loop.sample()
        least = min(least, least_distance(floor, loop.path()[:, POSITION]))
        loop.advance(loop.settings.control_period - loop.delay)
    assert least >= floor.needed - 1e-4
    assert state_error(loop.pose, pose(4.5, 1.0)) < 1e-2


def test_parts_of_a_way_lead_on_from_where_the_sphere_has_last_rested() -> None:
    """By a tenth of the radius, so that there are finitely many rests."""
    floor, goal = floor_of([*DOORWAY, (1.8, 0.0, 1.9, 2.2)]), pose(4.5, 1.0)
    loop = SampledLoop(pose(1.0, 1.0), SETTINGS, floor=floor, goal=goal, search_time=0.05)
    loop.run(16.0)
    assert state_error(loop.pose, goal) < 1e-2
    way = route_to(floor, goal[POSITION])
    tasks = [task for task in loop.worker.tasks if isinstance(task, SearchTask)]
    left = [way.length(task.rested) for task in tasks if task.rested is not None]
    assert len(left) > 5
    falls = -np.diff(left)
    assert ((falls == 0.0) | (falls > 0.1 * RADIUS - 2e-3)).all()
    # Nothing does from beside the goal.
    task = next(task for task in tasks if task.rested is not None)
    assert isinstance(task(), Plan)
    assert replace(task, rested=goal[POSITION] + 0.05)() == ""


class Given:
    """`Strategy` whose plan is a given hold, of a given status; none raises."""

    def __init__(self, status: PlanStatus, hold: FirstOrderHold | None) -> None:
        self.status, self.hold = status, hold

    def plan(self, situation: Situation) -> Plan:
        if self.hold is None:
            raise ArithmeticError("no plan")
        states = np.vstack((situation.state, situation.state))
        return Plan(self.status, self.hold.delayed(situation.time), states)

    def change(self, settings: ControllerSettings) -> None:
        pass

    def reset(self) -> None:
        pass


@pytest.mark.parametrize("status", [s for s in PlanStatus if s is not PlanStatus.RAMP_TO_REST])
def test_no_plan_of_any_status_leads_into_a_wall(status: PlanStatus) -> None:
    floor = floor_of([(3.0, 0.0, 3.1, 4.0)])
    strategy = Given(status, rolled(1.0, back=False))
    loop = SampledLoop(
        pose(2.0, 2.0), SETTINGS, floor=floor, goal=pose(1.0, 2.0), strategy=strategy
    )
    loop.run(4.0)
    assert least_distance(floor, loop.places) >= floor.needed
    assert not loop.controller.failures


def test_a_failing_strategy_stops_before_a_new_obstacle() -> None:
    strategy = Given(PlanStatus.SOLVED, rolled(1.5, back=False))
    loop = SampledLoop(
        pose(1.0, 2.0), SETTINGS, floor=floor_of([]), goal=pose(5.0, 2.0), strategy=strategy
    )
    loop.sample()
    loop.advance(0.05)
    loop.controller.floor = floor = Floor(
        Grid(floor_of([(1.5, 0.0, 1.6, 4.0)]).grid.occupied, 0.05), RADIUS, 0.02
    )
    strategy.hold = None
    loop.run(2.0)
    assert loop.controller.failures
    assert least_distance(floor, loop.places) > RADIUS
