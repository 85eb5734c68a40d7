# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A strategy that fails on demand never causes a command beyond the limits."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Mode
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.strategy.contract import SearchingStrategy
from sphere_nmpc.strategy.registry import make_strategy
from sphere_sim.faults.bad_strategy import BadStrategy, failing_on_demand
from sphere_sim.faults.limits import LimitCheck

ROBOT = RobotParameters()
SETTINGS = ControllerSettings(strategy="paper")
START = np.array([1.0, -1.0, 1.0, 0.0, 0.0, 0.0])
GOAL = np.array([0.0, 0.0, 0.6, 0.0, 0.0, 0.8])


@pytest.mark.parametrize(
    ("mode", "expected"),
    [("", Mode.TRACKING), ("raise", Mode.FALLBACK), ("nan", Mode.FALLBACK),
     ("nothing", Mode.FALLBACK), ("wild", Mode.TRACKING), ("late", Mode.TRACKING)],
)
def test_controller_reports_its_mode_and_keeps_the_limits(tmp_path, mode, expected) -> None:
    mode_file = tmp_path / "mode"
    controller = Controller(
        SETTINGS, ROBOT, BadStrategy(make_strategy(SETTINGS, ROBOT), mode_file)
    )
    controller.set_goal(GOAL)
    check = LimitCheck(ROBOT.max_rotor_speed, ROBOT.max_rotor_acceleration)
    for number in range(4):
        time = number * SETTINGS.period
        if number == 2:
            mode_file.write_text(mode)
        controller.observe(time, START)
        decision = controller.decide(time)
        hold = controller.commit(decision, time + 0.01)
        assert hold is not None
        check.trajectory(hold)
    assert decision.mode is expected
    assert not check.broken


def test_live_change_reaches_the_wrapped_strategy(tmp_path) -> None:
    settings = [SETTINGS, replace(SETTINGS, terminal_weight=1e6)]
    costs = []
    for changed in settings:
        controller = Controller(
            SETTINGS, ROBOT, BadStrategy(make_strategy(SETTINGS, ROBOT), tmp_path / "mode")
        )
        controller.set_goal(GOAL)
        controller.observe(0.0, START)
        controller.change(changed)
        costs.append(controller.decide(0.0).plan.cost)
    assert costs[1] < 0.1 * costs[0]


@pytest.mark.parametrize("name", STRATEGIES)
def test_wrapped_strategy_searches_beside_the_loop_if_it_does_without(tmp_path, name) -> None:
    inner = make_strategy(replace(SETTINGS, strategy=name), ROBOT)
    wrapped = failing_on_demand(inner, tmp_path / "mode")
    assert isinstance(wrapped, SearchingStrategy) == isinstance(inner, SearchingStrategy)
    assert isinstance(wrapped, SearchingStrategy) == (name == "time_optimal")
