# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Strategies with momentum: pushed, on a slope, out of balance, and with hardly any."""

from dataclasses import replace

import numpy as np
import pytest
from delayed_worker import DelayedWorker
from sampled_loop import ROBOT, SampledLoop
from situations import situation

from sphere_nmpc.model.course import Course
from sphere_nmpc.model.disturbance import (
    UNDISTURBED,
    Disturbance,
    imbalance_of_offset,
    rest_speeds,
    slope_torque,
    speeds_at_rest,
)
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.rotation import exponential
from sphere_nmpc.model.state import (
    MOMENTUM,
    NO_MOMENTUM,
    QUATERNION,
    Vector,
    make_state,
    state_error,
    upright_state,
)
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.strategy.at_rest import SATURATED, AtRest, holdable_goal
from sphere_nmpc.strategy.contract import Situation, make_strategy
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.time_optimal.chain import later
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.world.disturbances import DisturbanceSettings

LIMIT = ROBOT.max_rotor_speed
SETTLED = 1e-2
ORIGIN = upright_state(0.0, 0.0, 0.0)
NEAR = upright_state(0.6, 0.3, 0.7)
TILTED = make_state(np.zeros(2), exponential(np.array([0.15, 0.0, 0.0])))


def loop_of(
    start: Vector, goal: Vector = ORIGIN, strategy: str = "time_optimal", **world: float
) -> SampledLoop:
    """Return a loop whose controller knows momentum and disturbance."""
    settings = ControllerSettings(strategy=strategy, planning_effort=20_000)
    known = DisturbanceSettings(**world)
    return SampledLoop(start, settings, goal=goal, world=known, is_known=True)


def statuses(plans: list[Plan]) -> set[PlanStatus]:
    return {plan.status for plan in plans}


def held_by(loop: SampledLoop) -> Vector:
    """Return the rotor speeds that hold the momentum at the upright goal."""
    return rest_speeds(loop.momentum, ORIGIN[QUATERNION])


@pytest.mark.parametrize(
    ("start", "latest"), [(ORIGIN, 3.0), (upright_state(1.5, -1.0, 2.5), 6.0)],
    ids=["goal", "way"],
)
def test_sphere_that_is_pushed_arrives_and_stays(start: Vector, latest: float) -> None:
    loop = loop_of(start)
    loop.run(1.0)
    loop.plant.push(np.array([0.8, -0.5]))
    # What remains of a plan at the push may lead past the goal.
    assert statuses(loop.run(9.0)[1:]) == {PlanStatus.HOLDING, PlanStatus.SOLVED}
    # At the goal half a second after the push was measured.
    assert 1.0 < loop.settled() < latest
    # Momentum of the push: 0.94 N s of 37.5 rad/s each.
    assert np.linalg.norm(held_by(loop)) == pytest.approx(37.5 * np.hypot(0.8, 0.5), rel=1e-12)
    np.testing.assert_allclose(loop.plant.rotor_speeds, held_by(loop), atol=0.01)
    loop.check_limits()


def test_sphere_on_a_slope_settles_and_stays_while_the_momentum_grows() -> None:
    loop = loop_of(NEAR, slope=float(np.radians(0.2)), slope_direction=1.0)
    loop.run(10.0)
    assert loop.settled() < 5.0 and loop.error() < 1e-3
    assert np.linalg.norm(held_by(loop)) == pytest.approx(10.0 * 24.4 * 0.2, rel=0.01)
    # A command holds it exactly while it grows, but for what corrects the error.
    np.testing.assert_allclose(loop.plant.rotor_speeds, held_by(loop), atol=0.1)
    loop.check_limits()


def test_sphere_out_of_balance_unloads_its_rotors_and_returns() -> None:
    loop = loop_of(ORIGIN, mass_offset_x=2e-3)
    # 9.5 rad/s^2 load a rotor to four fifths of its limit in 8.4 s.
    assert statuses(loop.run(8.25)) == {PlanStatus.HOLDING} and loop.settled() == 0.0
    plans = loop.run(17.5)
    told = ["unloads" in plan.given_up for plan in plans]
    first, last = told.index(True), len(told) - told[::-1].index(True)
    assert all(told[first:last])
    # From four fifths of the limit to zero, seen once a sample.
    momenta = np.array([decision.momentum for decision in loop.decisions[-len(plans) :]])
    assert momenta[first][1] == pytest.approx(0.8 * LIMIT, abs=0.25 * 9.5)
    assert momenta[last][1] == pytest.approx(0.0, abs=0.25 * 9.5)
    assert np.max(np.abs(momenta)) < LIMIT
    assert PlanStatus.SATURATED not in statuses(plans)
    assert loop.error() < SETTLED
    loop.check_limits()


def test_saturated_rotors_stay_at_their_limits_until_the_momentum_can_be_held_again() -> None:
    loop = loop_of(ORIGIN, slope=float(np.radians(1.0)), slope_direction=0.5)
    # One rotor takes cos 0.5 of 24.4 rad/s^2: it is full after 4.7 s.
    assert statuses(loop.run(4.5)) == {PlanStatus.HOLDING}
    assert max(loop.errors()) < SETTLED
    assert statuses(loop.run(1.0)[-2:]) == {PlanStatus.SATURATED}
    assert loop.given_up == SATURATED
    assert loop.plant.rotor_speeds[1] == LIMIT
    # Level again the momentum stays too large, and the sphere rolls on. As it turns, so do the
    # speeds that would hold it, of which the rotors have what the limit allows.
    loop.tilt(0.0)
    assert statuses(loop.run(0.75)) == {PlanStatus.SATURATED}
    now = loop.decision.state
    held = np.clip(rest_speeds(now[MOMENTUM], now[QUATERNION]), -LIMIT, LIMIT)
    np.testing.assert_allclose(loop.decision.plan.hold.speeds[-1], held, rtol=1e-12)
    loop.tilt(np.radians(1.0), 0.5 - np.pi)
    loop.run(2.0)
    loop.tilt(0.0)
    began = loop.time
    assert statuses(loop.run(6.0)[-8:]) == {PlanStatus.HOLDING}
    assert loop.given_up == ""
    # 1 to 2 s were measured.
    assert loop.settled() < began + 4.0 and loop.error() < 1e-3
    loop.check_limits()


def test_plan_keeping_settles_with_momentum_and_reports_what_it_cannot_hold() -> None:
    slope = float(np.radians(0.2))
    loop = loop_of(upright_state(0.5, 0.3, 0.7), strategy="plan_keeping", slope=slope)
    loop.plant.push(np.array([0.3, 0.2]))
    loop.run(10.0)
    # 1e-3 was measured; with the speeds of rest of now, not of the end of the horizon, 0.1.
    assert loop.settled() < 9.0
    np.testing.assert_allclose(loop.plant.rotor_speeds, held_by(loop), atol=2.0)
    loop.push_momentum(np.array([0.0, 200.0, 0.0]))
    plan = loop.run(0.5)[0]
    assert plan.status is PlanStatus.SATURATED and plan.given_up == SATURATED
    loop.check_limits()


def test_plan_keeping_settles_at_the_nearest_goal_that_can_be_held() -> None:
    loop = loop_of(upright_state(0.5, 0.3, 0.7), TILTED, strategy="plan_keeping")
    loop.push_momentum(np.array([0.0, 30.0, 0.0]))
    assert all(plan.given_up.startswith("orientation by 8.") for plan in loop.run(12.0))
    # 1e-3 was measured; aiming at the goal itself leaves 9e-2.
    assert loop.error(holdable_goal(TILTED, loop.momentum, UNDISTURBED)) < SETTLED


def test_turn_about_the_vertical_is_corrected_by_the_momentum() -> None:
    """With a time constant of 3 s; rolling alone leaves all of the turn."""
    turn = 5e-3
    start = upright_state(0.0, 0.0, turn)
    loop = loop_of(start)
    loop.push_momentum(np.array([0.0, 30.0, 0.0]))
    speeds = rest_speeds(loop.momentum, start[QUATERNION])  # which hold the momentum already
    loop.controller.rotors.record(FirstOrderHold.constant(0.0, speeds))
    loop.simulator.speed_reference = speeds
    loop.plant.advance(speeds, 1e-9)
    loop.plant.displace(start)
    assert statuses(loop.run(6.0)) == {PlanStatus.HOLDING}
    assert abs(float(error_between(ORIGIN, loop.pose)[4])) < 0.3 * turn


SEARCHED = TimeOptimalSettings(longest_search=np.inf)
SCENARIO = draw_scenarios(1, 77)[0]
Cause = tuple[Vector, Disturbance]
NONE: Cause = (NO_MOMENTUM, UNDISTURBED)
TINY: dict[str, Cause] = {
    "momentum": (np.array([0.02, -0.01, 0.0]), UNDISTURBED),
    "slope": (NO_MOMENTUM, Disturbance(np.array([2e-3, -1e-3]))),
    "imbalance": (NO_MOMENTUM, Disturbance(imbalance=np.array([1e-3, 0.0, -2e-3]))),
}
tiny = pytest.mark.parametrize("cause", TINY.values(), ids=TINY)
LARGE: Cause = np.array([20.0, -10.0, 0.0]), Disturbance(
    slope_torque(ROBOT, np.radians(0.1), 2.0),
    imbalance_of_offset(ROBOT, np.array([5e-4, 0.0, 3e-4])),
)


def first_plan(strategy: str, now: Situation) -> Plan:
    return make_strategy(ControllerSettings(strategy=strategy), ROBOT).plan(now)


def at(distance: float, cause: Cause) -> Situation:
    """Return the situation with a goal at a distance [m]."""
    place = SCENARIO.start[:2] + distance * np.array([0.8, -0.6])
    return situation(make_state(place, SCENARIO.goal[QUATERNION]), *cause, SCENARIO.start)


@pytest.mark.parametrize("name", STRATEGIES)
def test_only_the_paper_ignores_momentum(name: str) -> None:
    disturbed, without = (
        first_plan(name, situation(ORIGIN, *cause, NEAR)).hold.speeds for cause in (LARGE, NONE)
    )
    assert np.array_equal(disturbed, without) is (name == "paper")


@tiny
def test_plan_is_nearly_that_without_momentum(cause: Cause) -> None:
    for distance in (0.1, 1.0, 30.0):
        plan, without = (first_plan("time_optimal", at(distance, c)) for c in (cause, NONE))
        assert plan.status is without.status is PlanStatus.SOLVED
        # Rounding alone changes which of the arrivals of a search is found.
        assert plan.arrival == pytest.approx(without.arrival, rel=0.03)
    plan, without = (first_plan("plan_keeping", at(1.0, c)) for c in (cause, NONE))
    assert plan.made.cost == pytest.approx(without.made.cost, rel=0.01)


@tiny
def test_sphere_rests_and_aims_as_without_momentum(cause: Cause) -> None:
    def noisy(now: Situation) -> Situation:
        return replace(now, plant=replace(now.plant, noise=1e-5))

    def planned(now: Situation) -> Plan:
        return TimeOptimalStrategy(ControllerSettings(), ROBOT, SEARCHED).plan(now)

    start = SCENARIO.start
    for away, stays in ((1.5e-3, True), (4e-3, False)):
        goal = apply_error(start, np.array([away, 0.0, 0.0, 0.0, 0.0]))
        plan = planned(noisy(situation(goal, *cause, start)))
        assert (plan.status is PlanStatus.HOLDING) is stays
    # Within the dead band nothing is corrected: the rotors hold the momentum.
    plan = planned(noisy(situation(start, *cause)))
    held = speeds_at_rest(*cause, start[QUATERNION], plan.hold.times[-1:])
    np.testing.assert_allclose(plan.hold.speeds[-1:], held, atol=1e-9)
    far = at(20.0, cause)
    assert AtRest(ControllerSettings(), ROBOT, SEARCHED).goal(far, None, False) is far.goal.pose


@pytest.mark.parametrize(
    "cause", [NONE, *TINY.values(), (np.array([15.0, 10.0, 0.0]), UNDISTURBED)],
    ids=["none", *TINY, "push"],
)
def test_new_goal_is_turned_to_on_the_way(cause: Cause) -> None:
    """The plan in force is followed until there is one to the new goal, which is upright."""
    upright = [upright_state(0.5, 0.5, 0.0), upright_state(-0.5, 1.0, 0.0)]
    courses = [Course.of(Goal(pose)) for pose in upright]
    now = situation(upright[0], *cause, SCENARIO.start)
    planner, found = TimeOptimalStrategy(ControllerSettings(), ROBOT, SEARCHED), []
    planner.search_beside(DelayedWorker(lambda: now.time, 0.05))
    for k in range(16):
        found.append(planner.plan(replace(now, course=courses[k // 8])))
        now = later(now, found[-1].hold, now.time + 0.25, 0.05)
    assert statuses(found[1:]) == {PlanStatus.SOLVED}
    assert state_error(found[-1].states[-1], upright[1]) < 1e-3
