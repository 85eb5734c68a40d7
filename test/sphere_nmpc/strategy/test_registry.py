# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The table of strategies, from which names, sample periods and classes come."""

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import STRATEGIES, ControllerSettings, StrategyEntry
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.registry import make_strategy
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
SPEEDS = np.array([30.0, -20.0])


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


@pytest.mark.parametrize("name", STRATEGIES)
def test_each_name_in_the_table_makes_the_strategy_at_its_path(name: str) -> None:
    strategy = make_strategy(ControllerSettings(strategy=name), ROBOT)
    found = f"{type(strategy).__module__}:{type(strategy).__name__}"
    assert found == STRATEGIES[name].path


def test_name_that_is_not_in_the_table_is_refused_with_those_that_are() -> None:
    with pytest.raises(InvalidParameterError, match=" or ".join(STRATEGIES)):
        ControllerSettings(strategy="constant")
