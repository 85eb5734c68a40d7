# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The ablation: its variants, how settings reach a run, its table, and how it continues."""

import sys

import ablation
import pytest
from ablation import DEFAULT, Run, Variant, main, measured, variants

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.registry import make_strategy
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.conditions import StudyConditions


def test_numbers_are_halved_and_doubled_or_set() -> None:
    assert variants(["least_dead_band"]) == [
        Variant("least_dead_band", 0.001), Variant("least_dead_band", 0.004)
    ]
    assert variants(["momentum_steps"]) == [
        Variant("momentum_steps", 4), Variant("momentum_steps", 16)
    ]
    words = ["slew_weight=20", "delays=1.0,1.1", "unloaded_share=-0.1", "slew_weight=20.0"]
    assert variants(words) == [
        Variant("slew_weight", 20.0), Variant("delays", (1.0, 1.1)),
        Variant("unloaded_share", -0.1),
    ]


@pytest.mark.parametrize(
    "word", ["nothing", "delays", "momentum_steps=1.5", "delays=1", "slew_weight=a"]
)
def test_wrong_variant_is_refused(word) -> None:
    with pytest.raises(ValueError):
        variants([word])


def test_run_has_the_settings_of_its_variant_and_leaves_none_behind(monkeypatch) -> None:
    seen = []

    def make(settings: ControllerSettings, robot: RobotParameters, tuning: object) -> object:
        seen.append(tuning)
        return make_strategy(settings, robot)

    monkeypatch.setattr(ablation, "TimeOptimalStrategy", make)
    (variant,) = variants(["slew_weight=20"])
    conditions = StudyConditions(duration=0.5)
    measured(variant.tuning, conditions, draw_scenarios(1, 1)[0])
    assert seen == [variant.tuning] and variant.tuning.slew_weight == 20.0
    Controller(conditions.controller, conditions.robot)
    assert len(seen) == 1


def test_ablation_continues_and_refuses_other_conditions(tmp_path, monkeypatch, capsys) -> None:
    made = []

    def run(tuning: object, conditions: object, scenario: object) -> Run:
        made.append(tuning)
        if len(made) == 7:
            raise KeyboardInterrupt
        return Run(float(len(made)), 1.0)

    monkeypatch.setattr(ablation, "measured", run)
    words = ["ablation", "slew_weight", "--out", str(tmp_path), "--jobs", "1", "--draw"]
    monkeypatch.setattr(sys, "argv", [*words, "3"])
    with pytest.raises(KeyboardInterrupt):
        main()
    first = (tmp_path / "table.md").read_text()
    main()
    # The default and the first variant are kept, the runs of the second are made again.
    assert made == [DEFAULT] * 3 + 3 * [variants(["slew_weight"])[0].tuning] + [
        variants(["slew_weight"])[1].tuning
    ] * 4
    table = (tmp_path / "table.md").read_text()
    assert table.startswith(first) and len(table.splitlines()) == 5
    assert "| `slew_weight` | 10 | 5 | 3 of 3 | 2.500 / 3.700 / 4.000 |" in table
    monkeypatch.setattr(sys, "argv", [*words, "4"])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2 and "choose another folder" in capsys.readouterr().err
