# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scripts of bench/: all can be imported, generated files are up to date, an ablation ablates."""

import runpy
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

import ablation
from parameter_tables import NODES, OF_ROBOT, PARTS, outputs, parameters_yaml

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.estimation import estimator
from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantity import quantities
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.conditions import StudyConditions

BENCH = Path(__file__).parents[2] / "bench"


@pytest.mark.parametrize("script", sorted(BENCH.rglob("*.py")), ids=lambda path: path.stem)
def test_script_can_be_imported(script, monkeypatch) -> None:
    monkeypatch.setattr(sys, "path", [str(script.parent), *sys.path])
    assert "__doc__" in runpy.run_path(str(script), run_name="imported")


@pytest.mark.parametrize(
    "numbers", [TimeOptimalSettings(leaving_error=7e-3), EstimatorSettings(window=7)]
)
def test_ablated_run_has_its_settings_and_leaves_none_behind(monkeypatch, numbers) -> None:
    seen = []
    for module, name in ((ablation, "TimeOptimalStrategy"), (estimator, "Scaling")):
        made = getattr(module, name)

        def make(first, second, numbers, made=made) -> object:
            seen.append(numbers)
            return made(first, second, numbers)

        monkeypatch.setattr(module, name, make)
    conditions = StudyConditions(duration=0.5)
    ablation.measured(numbers, conditions, draw_scenarios(1, 1)[0])
    assert numbers in seen
    seen.clear()
    Controller(conditions.controller, conditions.robot)
    assert seen and numbers not in seen


def values(settings: Any) -> dict[str, Any]:
    return {name: getattr(settings, name) for name in quantities(settings)}


@pytest.mark.parametrize("path", outputs(), ids=lambda path: path.name)
def test_file_is_up_to_date(path) -> None:
    assert path.read_text(encoding="utf-8") == outputs()[path], (
        "run python bench/documents/parameter_tables.py"
    )


@pytest.mark.parametrize("node", NODES)
def test_yaml_gives_the_defaults_back(node) -> None:
    given = yaml.safe_load(parameters_yaml())[f"/**/{node}"]["ros__parameters"]
    robot = given.pop("robot", None)
    given.pop("use_sim_time", None)
    expected = values(NODES[node])
    for prefix, _, settings in PARTS[node]:
        if prefix:
            assert given.pop(prefix) == values(settings)
        else:
            expected |= values(settings)
    assert {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()} == expected
    assert robot == (values(RobotParameters()) if node in OF_ROBOT else None)
    for key, value in given.items():
        # YAML 1.1 reads some numbers as text.
        assert isinstance(value, list) or type(value) is type(expected[key])
