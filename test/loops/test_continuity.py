# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Momentum of nearly zero: it matters little whether an estimator takes it for none."""

from dataclasses import replace

import numpy as np
import pytest
from delayed_worker import DelayedWorker

from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance, speeds_at_rest
from sphere_nmpc.model.error_state import apply_error
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import NO_MOMENTUM, QUATERNION, Vector, make_state, state_error
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.at_rest import AtRest
from sphere_nmpc.strategy.contract import Situation, make_strategy
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.time_optimal.background import later, solver_for
from sphere_nmpc.strategy.time_optimal.guide import local_goal
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy
from sphere_sim.scenario.scenarios import draw_scenarios

ROBOT = RobotParameters()
TUNING = TimeOptimalSettings(longest_search=np.inf)
SETTINGS = ControllerSettings()
SCENARIO = draw_scenarios(1, 77)[0]
START, GOAL = SCENARIO.start, SCENARIO.goal
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
Cause = tuple[Vector, Disturbance]
NONE: Cause = (NO_MOMENTUM, UNDISTURBED)
TINY: dict[str, Cause] = {
    "momentum": (np.array([0.02, -0.01, 0.0]), UNDISTURBED),
    "slope": (NO_MOMENTUM, Disturbance(np.array([2e-3, -1e-3]))),
    "imbalance": (NO_MOMENTUM, Disturbance(imbalance=np.array([1e-3, 0.0, -2e-3]))),
}
tiny = pytest.mark.parametrize("cause", TINY.values(), ids=TINY)


def situation(goal: Vector, cause: Cause) -> Situation:
    momentum, disturbance = cause
    return Situation(
        0.0, np.append(START, momentum), goal, np.zeros(2), ROBOT.lumped, disturbance=disturbance
    )


def plan_for(cause: Cause, distance: float, name: str = "time_optimal") -> Plan:
    """Return the first plan to a goal at a distance [m]."""
    goal = GOAL.copy()
    goal[:2] = START[:2] + distance * np.array([0.8, -0.6])
    settings = replace(SETTINGS, strategy=name)
    now = situation(goal, cause)
    return make_strategy(settings, ROBOT).plan(now)


@tiny
@pytest.mark.parametrize("distance", [0.1, 1.0, 30.0])
def test_plan_arrives_as_without_momentum(cause: Cause, distance: float) -> None:
    plan, without = plan_for(cause, distance), plan_for(NONE, distance)
    assert plan.status is without.status is PlanStatus.SOLVED
    # Rounding alone changes which of the arrivals of a search is found.
    assert plan.arrival == pytest.approx(without.arrival, rel=0.03)


@tiny
def test_short_horizon_leads_as_without_momentum(cause: Cause) -> None:
    plan, without = (plan_for(d, 1.0, "plan_keeping") for d in (cause, NONE))
    assert plan.cost == pytest.approx(without.cost, rel=0.01)


@tiny
def test_sphere_rests_in_the_dead_band_as_without_momentum(cause: Cause) -> None:
    for away, stays in ((1.5e-3, True), (4e-3, False)):
        goal = apply_error(START, np.array([away, 0.0, 0.0, 0.0, 0.0]))
        now = replace(situation(goal, cause), noise=1e-5)
        plan = TimeOptimalStrategy(SETTINGS, ROBOT, TUNING).plan(now)
        assert (plan.status is PlanStatus.HOLDING) is stays
    # Within it nothing is corrected: the rotors hold the momentum.
    plan = TimeOptimalStrategy(SETTINGS, ROBOT, TUNING).plan(replace(now, goal=START))
    turn, (momentum, disturbance) = START[QUATERNION], cause
    held = speeds_at_rest(momentum, disturbance, turn, plan.hold.times[-1:])
    np.testing.assert_allclose(plan.hold.speeds[-1:], held, atol=1e-9)


@tiny
def test_goal_is_aimed_at_as_without_momentum(cause: Cause) -> None:
    far = make_state(START[:2] + 20.0, GOAL[QUATERNION])
    now = situation(far, cause)
    assert AtRest(SETTINGS, ROBOT, TUNING).goal(now, None, holding=False) is far
    (aim,) = local_goal(now, solver_for(ROBOT, TUNING), 0).aims
    assert aim.is_final and aim.situation is now


@pytest.mark.parametrize(
    "cause", [NONE, *TINY.values(), (np.array([15.0, 10.0, 0.0]), UNDISTURBED)],
    ids=["none", *TINY, "push"],
)
def test_new_goal_is_turned_to_on_the_way(cause: Cause) -> None:
    """The plan in force is followed until there is one to the new goal, which is upright."""
    upright = [make_state(place, UPRIGHT) for place in ((0.5, 0.5), (-0.5, 1.0))]
    now = situation(upright[0], cause)
    planner, statuses = TimeOptimalStrategy(SETTINGS, ROBOT, TUNING), []
    planner.search_beside(DelayedWorker(lambda: now.time, 0.05))
    for k in range(16):
        plan = planner.plan(replace(now, goal=upright[k // 8]))
        statuses.append(plan.status)
        now = later(now, plan.hold, now.time + 0.25, 0.05)
    assert set(statuses[1:]) == {PlanStatus.SOLVED}
    assert state_error(plan.states[-1], upright[1]) < 1e-3
