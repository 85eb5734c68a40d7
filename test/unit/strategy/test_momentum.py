# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rest with momentum: goals that can be held, commands that hold it, plans that end so."""

from dataclasses import replace

import numpy as np
import pytest
from floor_plans import DOORWAY, floor_of
from motions import largest_slope
from situations import situation

from sphere_nmpc.model import rotation
from sphere_nmpc.model.course import LegEnd
from sphere_nmpc.model.disturbance import (
    UNDISTURBED,
    Disturbance,
    imbalance_of_offset,
    momentum_of_push,
    rest_speeds,
    slope_torque,
)
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import (
    MOMENTUM,
    NO_MOMENTUM,
    POSE,
    POSITION,
    QUATERNION,
    Vector,
    make_state,
    state_error,
)
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.at_rest import TOLERANCE, AtRest, holdable_goal
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.in_force import InForce
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.strategy.rest import hold_momentum
from sphere_nmpc.strategy.time_optimal.guide import Guide
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.search_task import solver_for
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_sim.study.motion import disturbance_of
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
TUNING = TimeOptimalSettings()
SOLVER = solver_for(ROBOT, TUNING)


def upright(x: float, y: float, heading: float = 0.0) -> Vector:
    return make_state((x, y), rotation.exponential(np.array([0.0, 0.0, heading])))


UPRIGHT = upright(1.0, -2.0)
OFFSET = imbalance_of_offset(ROBOT, np.array([2e-3, 0.0, 1e-3]))
LOADING = np.array([0.0, 1.0, 0.0])
"""Direction of the torque of `OFFSET` in an upright sphere of heading 0."""


def out_of_balance(momentum: float, slope: Vector = UNDISTURBED.slope) -> Situation:
    """Return a situation with momentum along the torque of the imbalance [rad/s]."""
    return situation(UPRIGHT, momentum * LOADING, Disturbance(slope, OFFSET))


@pytest.fixture
def held() -> AtRest:
    return AtRest(ControllerSettings(), ROBOT, TUNING)


@pytest.mark.parametrize(
    ("now", "holding"),
    [
        *((now, holding) for holding in (False, True) for now in (
            situation(UPRIGHT), situation(UPRIGHT, np.array([30.0, -20.0, 0.0])),
            out_of_balance(50.0),
        )),
        (out_of_balance(78.0), True),
        # On the way.
        (out_of_balance(92.0), False),
        # The torque of the imbalance unloads the rotors where they are.
        (out_of_balance(-92.0), True),
        (situation(UPRIGHT, 92.0 * LOADING), True),
        # A slope of 3 degrees loads them much faster, 73 rad/s^2, than 2.2 mm unload.
        (out_of_balance(92.0, slope_torque(ROBOT, np.radians(3.0), 0.0)), True),
    ],
)
def test_goal_is_kept_where_it_can_be_held_and_rotors_need_not_be_unloaded(
    held: AtRest, now: Situation, holding: bool
) -> None:
    assert held.goal(now, None, holding) is UPRIGHT and held.limitation == ""


def test_rotors_are_unloaded_at_the_orientation_that_does_so_fastest(held: AtRest) -> None:
    now = out_of_balance(92.0)
    assert now.disturbance.at_rest(UPRIGHT[QUATERNION]) @ LOADING > 0.0
    aimed = held.goal(now, None, holding=True)
    assert "unloads" in held.limitation
    np.testing.assert_array_equal(aimed[:2], UPRIGHT[:2])
    # No torque is larger than that of a horizontal offset.
    torque = now.disturbance.at_rest(aimed[QUATERNION])
    assert torque @ LOADING == pytest.approx(-np.linalg.norm(OFFSET), rel=1e-9)
    # It can be held there: neither is along the body's z axis.
    assert holdable_goal(aimed, now.momentum, now.disturbance) is aimed


def test_far_goal_is_approached_by_legs_on_the_straight_line() -> None:
    leg, direction, pushed = SOLVER.near_distance, np.array([0.8, 0.6]), np.array([10.0, -5.0, 0])

    def on_the_way(place: Vector, distance: float, momentum: Vector = NO_MOMENTUM) -> Situation:
        return situation(upright(*distance * direction, 0.6), momentum, pose=upright(*place))

    tiny = np.array([0.02, -0.01, 0.0])
    for momentum, distance in ((NO_MOMENTUM, 2.4e4), (tiny, 3.0 * leg), (pushed, 2.4 * leg)):
        near = on_the_way(np.zeros(2), distance, momentum)
        (aim,) = Guide(near, SOLVER).guidance(0).aims
        assert not aim.is_local and aim.situation is near
    for place, momentum, length in (
        (leg * direction, pushed, leg), (np.zeros(2), NO_MOMENTUM, 1e4),
    ):
        far = on_the_way(place, 1e5, momentum)
        (aim,) = Guide(far, SOLVER).guidance(0).aims
        np.testing.assert_allclose(aim.situation.goal.pose[POSITION], place + length * direction)
        assert aim.is_local and not aim.detour
        there = np.append(aim.situation.goal.pose, momentum)
        to_it = Plan(FirstOrderHold.constant(0.0, np.zeros(2)), there[None, :])
        leg = Guide(far, SOLVER).on_the_way(to_it).leg
        assert leg.end is LegEnd.THROUGH and leg.time_left > 1e4
        assert leg.way_left == pytest.approx(1e5 - np.linalg.norm(there[POSITION]))


def test_detour_of_a_local_goal_is_by_how_much_the_route_to_it_is_longer_than_the_line() -> None:
    start, goal = upright(1.0, 0.5), upright(5.0, 3.2)
    now = replace(situation(goal, pose=start), floor=floor_of(DOORWAY))
    guide = Guide(now, SOLVER)
    (aim,) = guide.guidance(0).aims
    reached = aim.situation.goal.pose[POSITION]
    ahead = guide.route.length(start[POSITION]) - guide.route.length(reached)
    direct = float(np.linalg.norm(reached - start[POSITION]))
    assert 0.0 < aim.detour < 0.2 * direct and aim.is_local
    assert aim.detour == pytest.approx(max(1e-3, ahead - direct))


@pytest.mark.parametrize(
    "world",
    [
        DisturbanceSettings(slope=float(np.radians(0.5)), slope_direction=2.0),
        DisturbanceSettings(mass_offset_x=2e-3, mass_offset_y=-1e-3),
    ],
    ids=["slope", "imbalance"],
)
def test_plant_stands_still_where_the_command_holds_its_momentum(
    world: DisturbanceSettings,
) -> None:
    start = upright(0.0, 0.0, 0.8)
    plant, disturbance = RollingPlant(ROBOT, start, world), disturbance_of(world, ROBOT)
    torque = disturbance.at_rest(start[QUATERNION])
    hold = FirstOrderHold(np.array([0.0, 0.1]), np.zeros((2, 2)))
    for _ in range(5):
        hold = hold.followed_by(hold_momentum(
            hold, hold.end * torque, disturbance, start[QUATERNION], ROBOT.max_rotor_speed
        ))
    assert hold.end == pytest.approx(5.1)
    assert np.max(np.abs(hold.speeds)) > 30.0
    for k in range(510):
        plant.advance(hold.at(0.01 * (k + 1)), 0.01)
    # The momentum of the first tenth is picked up late: 2e-3 were measured, and 0.8 or more with
    # the rotors at rest.
    assert np.max(np.abs(plant.state - start)) < 5e-3


@pytest.mark.parametrize("offset", [None, 0.0, 2e-3], ids=["push", "slope", "2 mm"])
@pytest.mark.parametrize("seed", range(15))
def test_goal_is_turned_to_where_momentum_and_its_rate_are_held(
    offset: float | None, seed: int
) -> None:
    """Of a push of about 1 N s, on up to 1 degree, with the centre of mass off by an offset."""
    rng = np.random.default_rng(seed)
    momentum, disturbance = momentum_of_push(ROBOT, rng.normal(size=2)), UNDISTURBED
    if offset is not None:
        disturbance = Disturbance(
            slope_torque(ROBOT, np.radians(rng.uniform(0.0, 1.0)), rng.uniform(-3.0, 3.0)),
            imbalance_of_offset(ROBOT, offset * rng.normal(size=3)),
        )
    level = upright(1.5, -0.7, rng.uniform(-np.pi, np.pi))
    assert holdable_goal(level, momentum, disturbance) is level
    goal = make_state(level[POSITION], rotation.random_quaternion(rng))
    assert holdable_goal(goal, NO_MOMENTUM, UNDISTURBED) is goal
    given = goal.copy()
    found = holdable_goal(goal, momentum, disturbance)
    assert found is not goal
    np.testing.assert_array_equal(goal, given)
    np.testing.assert_array_equal(found[POSITION], goal[POSITION])
    assert np.linalg.norm(found[QUATERNION]) == pytest.approx(1.0, abs=1e-12)
    torque = disturbance.at_rest(found[QUATERNION])
    axis = rotation.matrix(found[QUATERNION])[:, 2]
    assert abs(axis @ momentum) <= TOLERANCE + 1e-9
    assert abs(axis @ torque) <= TOLERANCE + 1e-9
    if offset is None:
        size = float(np.linalg.norm(momentum))
        share = abs(rotation.matrix(goal[QUATERNION])[:, 2] @ momentum) / size
        turned = float(rotation.angle_between(found[QUATERNION], goal[QUATERNION]))
        # The z axis at an angle asin(share) from the plane perpendicular to h has to reach what
        # the tolerance leaves. The iteration takes steps of up to half a radian, which together
        # are up to 4e-3 longer than the shortest way; a change below 1e-2 is not even told.
        least = np.arcsin(max(0.0, share - TOLERANCE / size))
        assert least - 1e-6 <= turned <= np.arcsin(share) + 5e-3


PUSH = momentum_of_push(ROBOT, np.array([0.6, 0.4]))
SLOPE = slope_torque(ROBOT, np.radians(0.3), 2.0)
UNBALANCED = imbalance_of_offset(ROBOT, np.array([5e-4, -8e-4, 6e-4]))


@pytest.mark.parametrize(
    ("momentum", "disturbance"),
    [
        (PUSH, UNDISTURBED), (NO_MOMENTUM, Disturbance(SLOPE)),
        (NO_MOMENTUM, Disturbance(imbalance=UNBALANCED)), (PUSH, Disturbance(SLOPE, UNBALANCED)),
    ],
    ids=["push", "slope", "imbalance", "all"],
)
def test_plan_ends_at_rest_at_the_goal_as_predicted_and_keeps_every_limit(
    momentum: Vector, disturbance: Disturbance
) -> None:
    goal = upright(0.0, 0.0, -0.5)
    start = make_state((0.7, -0.4), rotation.exponential(np.array([0.4, -0.5, 0.6])))
    now = situation(goal, momentum, disturbance, start, (8.0, -4.0))
    arrival = ArrivalSearch(SOLVER, now, 1).improve(60_000)
    assert arrival is not None
    hold, constants = arrival.hold, ROBOT.lumped.as_array()
    states = roll_out(now.state, hold.speeds, np.diff(hold.times), constants, 0.01, disturbance)
    end, middle = states[-1], len(hold.times) // 2
    # What the plan may leave, 1e-4, and the integration error of its steps of 62.5 ms.
    assert state_error(end, goal) < 3e-4
    rest = rest_speeds(end[MOMENTUM], goal[QUATERNION])
    assert np.linalg.norm(rest) > 1.0
    # A terminal error of 1e-4 of the largest speed; steps of 62.5 ms hardly change the momentum.
    allowed = 0.02
    np.testing.assert_allclose(hold.speeds[-1], rest, atol=allowed)
    np.testing.assert_allclose(arrival.states[-1, MOMENTUM], end[MOMENTUM], atol=allowed)
    np.testing.assert_array_equal(hold.speeds[0], now.speeds)
    assert np.max(np.abs(hold.speeds)) <= ROBOT.max_rotor_speed
    assert largest_slope(hold) <= ROBOT.max_rotor_acceleration + 1e-3
    predicted = InForce(arrival, now, ROBOT).at(float(hold.times[middle]))
    assert state_error(predicted, states[middle, POSE]) < 1e-4
    np.testing.assert_allclose(predicted[MOMENTUM], states[middle, MOMENTUM], atol=1e-2)
