# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Strategies by name, and parameters that change between two samples, with the plan kept."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import without_momentum
from sphere_nmpc.settings import STRATEGIES, ControllerSettings, StrategyEntry
from sphere_nmpc.strategy.contract import Situation, Strategy, make_strategy
from sphere_nmpc.strategy.plan import Plan
from sphere_sim.scenario.scenarios import PAPER_CASES

ROBOT = RobotParameters()
CASE = PAPER_CASES[1]
FIRST = Situation(0.0, without_momentum(CASE.start), CASE.goal, np.zeros(2), ROBOT.lumped)


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


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("nowhere:Strategy", "imported (ModuleNotFoundError: No module named 'nowhere')"),
        ("sphere_nmpc.settings:Missing", "imported (AttributeError: "),
        ("no path", "imported ("),
        ("sphere_nmpc.settings:StrategyEntry", "(it lacks plan, change, reset)"),
        ("sphere_nmpc.settings", "(it lacks plan, change, reset)"),
    ],
)
def test_strategy_that_is_none_is_named_with_what_is_missing(path: str, words: str) -> None:
    with pytest.raises(InvalidParameterError, match="strategy: given '") as caught:
        StrategyEntry(0.25, path).load()
    assert words in str(caught.value)


@pytest.mark.parametrize("name", ["plan_keeping", "paper"])
def test_changed_cap_on_iterations_and_weight_hold_from_the_next_plan_on(name: str) -> None:
    settings = ControllerSettings(strategy=name)
    strategy, second = make(settings)
    assert strategy.plan(second).iterations > 1
    strategy.change(replace(settings, max_iterations=1))
    assert strategy.plan(second).iterations == 1
    strategy.change(replace(settings, input_weight=1e6))
    assert np.max(np.abs(strategy.plan(second).hold.speeds[1:])) < 1.0
