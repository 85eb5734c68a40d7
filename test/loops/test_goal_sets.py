# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals that leave the heading or the orientation free: reached, and no later than a full pose."""

from dataclasses import replace

import numpy as np
import pytest
from sampled_loop import SampledLoop

from sphere_nmpc.conditions import Kind
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, position_error, upright_state, without_momentum
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation, make_strategy
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios

pytestmark = pytest.mark.slow

ROBOT = RobotParameters()
SETTINGS = ControllerSettings()
SETS = [Orientation.ANY_HEADING, Orientation.ANY]
SCENARIOS = draw_scenarios(12, 21, "anywhere")


def duration(scenario: Scenario, kind: Orientation) -> float:
    """Return the duration of the first plan [s]."""
    goal = kind.nearest(scenario.goal, scenario.start)
    start = without_momentum(scenario.start)
    situation = Situation(0.0, start, goal, np.zeros(2), ROBOT.lumped, orientation=kind)
    return make_strategy(SETTINGS, ROBOT).plan(situation).arrival


@pytest.mark.parametrize("kind", SETS)
def test_first_plan_to_a_set_is_no_longer(kind: Orientation) -> None:
    full = np.array([duration(scenario, Orientation.FULL) for scenario in SCENARIOS])
    free = np.array([duration(scenario, kind) for scenario in SCENARIOS])
    # Plans are found by a random search: 3 % is about its 90th percentile.
    assert np.all(free < 1.03 * full)
    assert np.median(free / full) < (0.95 if kind is Orientation.ANY else 1.0)


def reached(loop: SampledLoop, goal: Goal) -> SampledLoop:
    """Return the loop after it has run to a goal, which it stays at."""
    loop.controller.set_goal(goal)
    loop.run(14.0)
    assert loop.decision.mode is Kind.AT_GOAL, loop.decision.plan.message
    assert loop.decision.error < 1e-2
    assert loop.controller.failures == 0
    return loop


@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("strategy", ["time_optimal", "plan_keeping"])
def test_sphere_arrives_and_rests_at_a_set(strategy: str, kind: Orientation) -> None:
    scenario = SCENARIOS[0]
    loop = SampledLoop(scenario.start, replace(SETTINGS, strategy=strategy))
    reached(loop, Goal(scenario.goal, kind))
    nearest = kind.nearest(scenario.goal, loop.pose)
    assert np.linalg.norm(loop.pose - nearest) < 1e-2
    assert not np.any(np.abs(loop.simulator.plant.rotor_speeds) > 0.5)


@pytest.mark.parametrize("kind", SETS)
def test_pushed_sphere_comes_to_rest_at_a_set(kind: Orientation) -> None:
    loop = SampledLoop(upright_state(0.0, 0.0, 0.0))
    loop.controller.set_goal(Goal(upright_state(1.0, 0.5, 0.0), kind))
    loop.run(0.5)
    loop.simulator.plant.push(np.array([0.4, -0.3]))
    reached(loop, Goal(upright_state(1.0, 0.5, 0.0), kind))


def test_round_numbers_and_the_place_where_it_is() -> None:
    start = upright_state(0.0, 0.0, 0.0)
    points: list[Vector] = [start, upright_state(1.0, 0.0, 0.0), upright_state(0.0, 0.001, 0.0)]
    for point in points:
        loop = reached(SampledLoop(start), Goal(point, Orientation.ANY))
        assert position_error(loop.pose, point) < 1e-2
