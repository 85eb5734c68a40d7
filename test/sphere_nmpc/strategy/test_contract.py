# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Strategies by name, and parameters that change between two samples, with the plan kept."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION
from sphere_nmpc.settings import STRATEGIES, ControllerSettings, StrategyEntry
from sphere_nmpc.strategy.contract import Situation, Strategy, make_strategy
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
SPEEDS = np.array([30.0, -20.0])
CASE = PAPER_CASES[1]
FIRST = Situation(0.0, CASE.start, CASE.goal, np.zeros(2), ROBOT.lumped)


def situation_after(plan: Plan, time: float) -> Situation:
    """Return the situation at the second knot of a plan that was followed exactly."""
    knot = int(np.argmin(np.abs(plan.hold.times - time)))
    return replace(
        FIRST, time=time, state=plan.states[knot], input_in_force=plan.hold.speeds[knot]
    )


def make(settings: ControllerSettings) -> tuple[Strategy, Situation]:
    """Return a strategy that follows a plan, and the situation a sample later."""
    strategy = make_strategy(settings, ROBOT)
    return strategy, situation_after(strategy.plan(FIRST), settings.period)


@pytest.mark.parametrize("name", STRATEGIES)
def test_plan_that_is_followed_survives_a_change(name: str) -> None:
    settings = ControllerSettings(strategy=name)
    strategy, second = make(settings)
    assert f"{type(strategy).__module__}:{type(strategy).__name__}" == STRATEGIES[name].path
    strategy.change(replace(settings, goal_tolerance=0.02))
    unchanged, _ = make(settings)
    found, expected = strategy.plan(second), unchanged.plan(second)
    np.testing.assert_array_equal(found.hold.speeds, expected.hold.speeds)
    # A strategy without that plan finds another one.
    fresh = make_strategy(settings, ROBOT).plan(second)
    assert not np.array_equal(fresh.hold.speeds, expected.hold.speeds)


@pytest.mark.parametrize("name", ["plan_keeping", "paper"])
def test_changed_cap_on_iterations_and_weight_hold_from_the_next_plan_on(name: str) -> None:
    settings = ControllerSettings(strategy=name)
    strategy, second = make(settings)
    assert strategy.plan(second).iterations > 1
    strategy.change(replace(settings, max_iterations=1))
    assert strategy.plan(second).iterations == 1
    strategy.change(replace(settings, input_weight=1e6))
    assert np.max(np.abs(strategy.plan(second).hold.speeds[1:])) < 1.0


def test_changed_input_weight_holds_for_corrections_at_the_goal() -> None:
    settings = ControllerSettings()
    state = CASE.goal.copy()
    state[POSITION] += 5e-3
    near = replace(FIRST, state=state, noise=1e-3)
    strategy = make_strategy(settings, ROBOT)
    before = strategy.plan(near)
    assert before.status is PlanStatus.HOLDING
    strategy.change(replace(settings, input_weight=1e6))
    after = strategy.plan(near)
    assert np.max(np.abs(after.hold.speeds)) < 0.1 * np.max(np.abs(before.hold.speeds))


class ConstantSpeeds:
    """Bring the rotors to constant speeds within a sample period, whatever the goal."""

    def __init__(self, settings: ControllerSettings, robot: RobotParameters) -> None:
        self._period = settings.period

    def plan(self, situation: Situation) -> Plan:
        times = situation.time + self._period * np.arange(4)
        hold = FirstOrderHold(times, np.vstack((situation.input_in_force, *[SPEEDS] * 3)))
        return Plan(PlanStatus.SOLVED, hold, np.tile(situation.state, (4, 1)))

    def change(self, settings: ControllerSettings) -> None:
        raise NotImplementedError

    def reset(self) -> None:
        pass


def test_one_line_in_the_table_adds_a_strategy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(STRATEGIES, "constant", StrategyEntry(0.4, f"{__name__}:ConstantSpeeds"))
    settings = ControllerSettings(strategy="constant")
    assert settings.period == settings.control_period == 0.4
    scenario = PAPER_CASES[1]
    simulator = Simulator(SimulatorSettings(initial_state=tuple(scenario.start)), ROBOT)
    controller = Controller(settings, ROBOT)
    found = run_closed_loop(simulator, controller, scenario.goal, 2.0, settings.control_period)
    assert controller.failures == 0
    settled = found.speeds[found.times >= 0.4]
    np.testing.assert_allclose(settled, np.tile(SPEEDS, (len(settled), 1)), atol=1e-9)


def test_name_that_is_not_in_the_table_is_refused_with_those_that_are() -> None:
    with pytest.raises(InvalidParameterError, match=" or ".join(STRATEGIES)):
        ControllerSettings(strategy="constant")
