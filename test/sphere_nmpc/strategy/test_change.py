# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters that change between two samples: the plan is kept, the new values are used."""

from dataclasses import replace

import numpy as np
import pytest
from delayed_worker import DelayedWorker

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.strategy.contract import Situation, Strategy
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.registry import make_strategy
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.search_task import SearchTask
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy
from sphere_sim.scenario.scenarios import PAPER_CASES

ROBOT = RobotParameters()
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


def test_changed_planning_effort_is_spent_from_the_next_sample_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = ControllerSettings(planning_effort=40_000)
    strategy, second = make(settings)
    spent = []
    improve = ArrivalSearch.improve

    def recorded(search: ArrivalSearch, work: int, deadline: float = np.inf) -> object:
        spent.append(work)
        return improve(search, work, deadline)

    monkeypatch.setattr(ArrivalSearch, "improve", recorded)
    unchanged = strategy.plan(second)
    strategy.change(replace(settings, planning_effort=200_000))
    strategy.plan(situation_after(unchanged, 2.0 * settings.period))
    assert spent[1] == 5 * spent[0]


def test_search_in_progress_goes_on_after_a_change() -> None:
    settings = ControllerSettings(control_rate=100.0)
    strategy = make_strategy(settings, ROBOT)
    assert isinstance(strategy, TimeOptimalStrategy)
    worker = DelayedWorker(lambda: now, 0.01)
    strategy.search_beside(worker)
    now = 0.0
    assert strategy.plan(FIRST).status is PlanStatus.RAMP_TO_REST
    strategy.change(replace(settings, planning_effort=100_000))
    now = 0.01
    assert strategy.plan(replace(FIRST, time=now)).status is PlanStatus.SOLVED
    searches = [task for task in worker.tasks if isinstance(task, SearchTask)]
    assert [task.known for task in searches[:1]] == [None]
    assert all(task.known is not None for task in searches[1:]), "for an earlier arrival"


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


@pytest.mark.parametrize("name", STRATEGIES)
def test_every_input_weight_in_range_makes_a_strategy(name: str) -> None:
    settings = ControllerSettings(strategy=name, input_weight=1e6)
    assert np.isfinite(make_strategy(settings, ROBOT).plan(FIRST).hold.speeds).all()
