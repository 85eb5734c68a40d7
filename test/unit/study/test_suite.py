# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Suites: their files, the scores of policies, and the verb ``study --suite``."""

import hashlib
import re
import runpy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from document_commands import ROOT
from documented_examples import EXAMPLES

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy
from sphere_sim.cli.main import main as command
from sphere_sim.cli.study import _SUITES
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study import suite
from sphere_sim.study.suite import FOLDER, SUITES, scenarios_of, score
from sphere_sim.study.tables import scores, with_bounds

DIGESTS = {
    "point-v1": "0a58fcd509a02244",
    "contact-v1": "fe0b700564304f77",
    "worlds-v1": "a45db388700b2957",
}
"""Beginnings of the digests of all files of a suite: they are never changed."""


@pytest.fixture
def brief(monkeypatch) -> None:
    """Have two short runs in a suite."""
    scenarios, known = scenarios_of("point-v1")
    runs = [k for k, run in enumerate(scenarios) if run.extra["kind"] == "half_turn"][:2]
    some = [scenarios[k] for k in runs], [known[k] for k in runs]
    monkeypatch.setattr(suite, "scenarios_of", lambda name: some)
    monkeypatch.setitem(SUITES, "point-v1", replace(SUITES["point-v1"], duration=4.0))
    monkeypatch.setattr("sphere_sim.study.study.draw", lambda *arguments: None)


def test_suites_are_frozen_small_and_offered_by_the_verb() -> None:
    digests, size = {}, 0
    for name, conditions in SUITES.items():
        plant = conditions.simulator.plant, conditions.perturbation, conditions.duration
        content = repr((*plant, conditions.robot)).encode()
        for path in sorted((FOLDER / name).iterdir()):
            content += path.name.encode() + path.read_bytes()
        digests[name], size = hashlib.sha256(content).hexdigest()[:16], size + len(content)
        scenarios, known = scenarios_of(name)
        assert len(scenarios) >= 30 and 1.0 < min(known) < max(known) < 0.75 * conditions.duration
        assert all(run.map_file for run in scenarios) == (name == "worlds-v1")
    assert digests == DIGESTS and size < 100_000 and tuple(SUITES) == _SUITES


def test_score_of_a_run_is_best_known_over_settling_time_and_0_for_a_contact() -> None:
    kinds = [Scenario(np.zeros(6), np.zeros(6), extra={"kind": kind}) for kind in "aabbb"]
    found = [{"settled": time is not None, "settle_time_s": time, "contacts": touches}
             for time, touches in ((4.0, 0), (1.0, 0), (None, 0), (2.0, 0), (2.0, 3))]
    table = scores(kinds, with_bounds(found, [np.nan] * 5, [2.0] * 5))
    assert {kind: row["score"] for kind, row in table.items()} == pytest.approx(
        {"a": 0.75, "b": 1.0 / 3.0, "all": 0.5}
    )
    assert (table["all"]["settled"], table["all"]["contacts"]) == (4, 3)
    assert table["b"]["ratio"]["median"] == 1.0 and scores(kinds, found) == {}


@pytest.mark.slow
def test_same_policy_has_the_same_score_however_it_is_given(brief, tmp_path, capsys) -> None:
    named = score("time_optimal")
    assert named == score("time_optimal", jobs=2) and 0.8 < named.figure <= 1.0
    assert score(TimeOptimalStrategy).kinds == named.kinds
    arguments = ["--suite", "point-v1", "--strategy", "time_optimal", "--jobs", "1"]
    assert command(["study", *arguments, "--out", str(tmp_path / "out")]) == 0
    assert str(named) in capsys.readouterr().out


@pytest.mark.slow
def test_policy_of_the_document_scores_what_its_table_has(monkeypatch) -> None:
    text = (ROOT / "docs" / "suites.md").read_text(encoding="utf-8")
    code, table = re.findall(r"```(?:python|text)\n(.*?)```", text, re.DOTALL)[:2]
    shown = next(line.split() for line in table.splitlines() if line.startswith("paper"))
    some = [part[: int(shown[1])] for part in scenarios_of("point-v1")]
    monkeypatch.setattr(suite, "scenarios_of", lambda name: some)
    found = []
    exec(code, {"print": found.append})
    (row,) = (row for kind, row in found[0].kinds.items() if kind == "paper")
    # A run that passes near a saddle point may take a sixth longer on another processor.
    assert row["settled"] == int(shown[2]) and abs(row["score"] - float(shown[3])) < 0.05


@pytest.mark.slow
def test_function_is_asked_each_period_and_its_errors_are_shown(brief) -> None:
    asked = []

    def resting(situation: Situation, gain: float = 0.0) -> Any:
        asked.append(situation.time)
        return gain * situation.speeds if len(asked) != 3 else [0.0]

    example = runpy.run_path(str(EXAMPLES / "sampling_mpc.py"))["SamplingMpc"]
    half = ControllerSettings(sample_period=0.5)
    assert score(example, settings=half) == score(example, settings=half), "made for each run"
    found = score(resting, settings=half)
    assert found.figure == 0.0 and asked[:8] == [0.5 * k for k in range(8)]
    assert str(found).endswith("such as InvalidParameterError: policy: given array([0.]), "
                               "expected two rotor speeds [rad/s]")
    with pytest.raises(InvalidParameterError, match="policy: given 3, expected the name"):
        score(3)  # type: ignore[arg-type]


def test_environment_of_the_example_is_one_of_gymnasium_and_rewards_the_arrival() -> None:
    pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    example = runpy.run_path(str(EXAMPLES / "gymnasium_env.py"))
    env = example["RollToPose"]()
    check_env(env, skip_render_check=True)
    env.reset(seed=1)
    assert env.step(np.zeros(2))[1:4] == (0.0, False, False)
    env._simulator.plant.displace(env._scenario.goal)
    _, reward, arrived, *_ = env.step(np.zeros(2))
    assert arrived and reward == env._scenario.lower_bound(RobotParameters()) / 0.5
