# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The ablation: its variants, and how their settings reach a run."""

import ablation
import pytest
from ablation import DEFAULT, measured, variants

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import make_strategy
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.conditions import StudyConditions


def test_numbers_are_halved_and_doubled_or_set() -> None:
    words = ["momentum_steps", "slew_weight=20", "delays=1.0,1.1", "slew_weight=20.0"]
    assert variants(words) == [
        ("momentum_steps", 4), ("momentum_steps", 16), ("slew_weight", 20.0),
        ("delays", (1.0, 1.1)),
    ]
    for wrong in ("nothing", "delays", "momentum_steps=1.5", "slew_weight=a"):
        with pytest.raises(ValueError):
            variants([wrong])


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
