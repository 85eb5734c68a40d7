# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The ablation: settings of a variant reach its runs."""

import ablation
from ablation import DEFAULT, measured

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import make_strategy
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.conditions import StudyConditions


def test_run_has_the_settings_of_its_variant_and_leaves_none_behind(monkeypatch) -> None:
    seen = []

    def make(settings: ControllerSettings, robot: RobotParameters, tuning: object) -> object:
        seen.append(tuning)
        return make_strategy(settings, robot)

    monkeypatch.setattr(ablation, "TimeOptimalStrategy", make)
    conditions = StudyConditions(duration=0.5)
    measured(DEFAULT, conditions, draw_scenarios(1, 1)[0])
    Controller(conditions.controller, conditions.robot)
    assert seen == [DEFAULT]
