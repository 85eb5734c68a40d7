# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The monitor of Eq. (42), on hand-calculated numbers and on a closed loop of the paper."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.stability import Sample, StabilityMonitor, neighbourhood_radius
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, without_momentum
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.paper import PaperStrategy
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

GOAL = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def sample(time: float, x: float, value: float, speeds: tuple[float, float]) -> Sample:
    state = GOAL + np.array([x, 0.0, 0.0, 0.0, 0.0, 0.0])
    return Sample(time, state, GOAL, value, np.array(speeds), (0.5, 1e8, 100.0))


@pytest.mark.parametrize(
    ("x", "value", "change", "violations", "not_nearer"),
    [(1.0, -300.0, -1300.0, 0, 0), (1.0, -253.9, -1253.9, 1, 0), (2.5, -300.0, -1300.0, 0, 1)],
    ids=["decrease", "too little", "error grows"],
)
def test_decrease_of_the_value_agrees_with_hand_calculation(
    x: float, value: float, change: float, violations: int, not_nearer: int
) -> None:
    monitor = StabilityMonitor()
    first = monitor.update(sample(0.0, 2.0, 1000.0, (30.0, -40.0)))
    assert np.isnan([first.value_change, first.allowed_change]).all()
    assert (first.judged, first.inside) == (0, False)
    report = monitor.update(sample(0.5, x, value, (0.0, 0.0)))
    assert report.allowed_change == pytest.approx(-(4.0 + 0.5 * 2500.0))
    assert report.value_change == pytest.approx(change)
    assert (report.judged, report.violations, report.not_nearer) == (1, violations, not_nearer)


@pytest.mark.parametrize("case", PAPER_CASES)
def test_eq_42_compares_the_value_with_the_cost_of_the_knots_that_are_left(case: int) -> None:
    """So it is Eq. (39) at the next state, which has one knot less."""
    scenario, robot = PAPER_CASES[case], RobotParameters()
    settings = ControllerSettings(strategy="paper")
    start = without_momentum(scenario.start)
    situation = Situation.of(0.0, start, scenario.goal, np.zeros(2), robot.lumped)
    plan = PaperStrategy(settings, robot).plan(situation)
    first = Sample(
        0.0, scenario.start, scenario.goal, plan.made.cost, plan.hold.speeds[1],
        (settings.alpha, settings.terminal_weight, robot.max_rotor_speed),
    )
    errors = np.sum((plan.states[:, POSE] - scenario.goal) ** 2, axis=1)
    efforts = settings.alpha * np.sum(plan.hold.speeds**2, axis=1)
    left = float(np.sum(errors[1:-1]) + np.sum(efforts[2:]))
    left += settings.terminal_weight * float(errors[-1])
    assert first.value - first.stage_cost == pytest.approx(left, rel=1e-9)


def test_neighbourhood_of_the_paper_is_one_hundredth_and_not_judged() -> None:
    """Inside, not even a jump to the goal satisfies Eq. (36)."""
    radius = neighbourhood_radius(0.5, 1e8, 100.0)
    assert radius == pytest.approx(1e-2, rel=1e-7)
    assert neighbourhood_radius(0.5, 1.0, 100.0) == np.inf
    for error, holds in ((0.99 * radius, False), (1.01 * radius, True)):
        assert (-1e8 * error**2 + error**2 + 2.0 * 0.5 * 100.0**2 <= 0.0) is holds
    monitor = StabilityMonitor()
    assert monitor.update(sample(0.0, 0.009, 5.0, (0, 0))).inside
    report = monitor.update(sample(0.5, 0.011, 6.0, (0, 0)))
    assert (report.inside, report.judged, report.violations) == (False, 0, 0)


@pytest.mark.parametrize(
    "change",
    [
        {"goal": -GOAL}, {"weights": (1.0, 1e8, 100.0)}, {"time": 0.0}, {"value": np.nan},
        {"state": np.full(6, np.nan)},
    ],
)
def test_transition_to_another_value_function_back_in_time_or_to_nonsense_is_not_judged(
    change: dict[str, object],
) -> None:
    monitor = StabilityMonitor()
    monitor.update(sample(0.0, 1.0, 10.0, (0, 0)))
    other = replace(sample(0.5, 2.0, 99.0, (0, 0)), **change)
    assert np.isnan(monitor.update(other).value_change)
    monitor.update(sample(1.0, 0.9, 9.0, (0, 0)))
    assert monitor.update(sample(1.5, 0.8, 7.0, (0, 0))).judged == 1 + ("time" in change)


def test_value_function_of_case_1_falls_as_eq_42_says_though_the_error_does_not() -> None:
    scenario, robot = PAPER_CASES[1], RobotParameters()
    settings = ControllerSettings(strategy="paper")
    simulator = Simulator(SimulatorSettings(initial_state=tuple(scenario.start)), robot)
    run = run_closed_loop(simulator, Controller(settings, robot), scenario.goal, 16.0, 0.5)
    monitor = StabilityMonitor()
    for k, (decision, state) in enumerate(zip(run.decisions, run.states, strict=False)):
        report = monitor.update(Sample(
            0.5 * k, state, scenario.goal, decision.plan.made.cost, decision.plan.hold.speeds[1],
            (settings.alpha, settings.terminal_weight, robot.max_rotor_speed),
        ))
    # It enters D after 12.5 s, 25 samples; another solver may take another path there.
    assert 15 <= report.judged <= 31
    assert report.inside
    assert report.violations == 0
    assert 0 < report.not_nearer < 5
