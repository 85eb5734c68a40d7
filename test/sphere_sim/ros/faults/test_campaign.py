# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A short campaign over DDS: poses are lost, a node is killed, the disk is full."""

import json

import pytest

from sphere_nmpc.model.parameters import RobotParameters

pytest.importorskip("rclpy")

from sphere_sim.cli.main import main as command
from sphere_sim.faults.outcome import Outcome, write_json

SHORT = (
    "pose_dropped_100", "pose_nan", "controller_killed", "disk_full", "parameters_at_start",
)
LATE_REST = "rotors turned for"
"""A complaint that a busy machine alone can cause: the controller was not run for seconds."""
ROBOT = RobotParameters()


def main(arguments: list[str]) -> int:
    """Run the verb as the command does."""
    return command(["faults", *arguments])


@pytest.mark.slow
def test_faults_are_named_and_the_goal_is_reached_within_the_limits(tmp_path, capsys) -> None:
    path = tmp_path / "faults.json"
    code = main(["--json", str(path), "--out", str(tmp_path / "out"), "--rtf", "1",
                 "--seed", "3", "--fault", *SHORT])
    table = {row["fault"]: row for row in json.loads(path.read_text())["faults"]}
    assert list(table) == list(SHORT)
    trials, summary = capsys.readouterr().out.split("limits: ")
    complaints = [line for line in summary.splitlines() if line.startswith(SHORT)]
    assert [line for line in complaints if LATE_REST not in line] == []
    survived = {name for name in SHORT if f"{name}: survived, at the goal" in trials}
    assert survived == set(SHORT) - {line.partition(":")[0] for line in complaints}
    assert code == (1 if complaints else 0)
    for name, row in table.items():
        assert row["tried"] == 1 and row["survived"] == (name in survived)
        assert row["recover_s"] >= 0.0
        assert 0.0 < row["worst_speed"] <= ROBOT.max_rotor_speed * 1.001
        assert 0.0 < row["worst_slew"] <= ROBOT.max_rotor_acceleration * 1.001


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (["--fault", "pose_lost"], "choose from"),
        (["--rtf", "50"], "expected 0.5 to 5"),
        (["--seed", "-1"], "expected a whole number from 0 to"),
        (["--repeat", "0"], "expected a whole number from 1 to"),
        (["--triples", "0"], "expected a whole number from 1 to"),
        (["--rate", "1000"], "expected a number from 20 to 500"),
        (["--plant", "flat"], "choose from"),
    ],
)
def test_wrong_arguments_are_refused_in_a_line(tmp_path, capsys, wrong, message) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["--json", str(tmp_path / "f.json"), *wrong])
    assert message in capsys.readouterr().err
    assert not (tmp_path / "f.json").exists()


def test_jobs_are_refused_in_a_given_domain(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert main(["--json", str(tmp_path / "f.json"), "--jobs", "2"]) == 2
    assert "ROS_DOMAIN_ID: given '7', expected no value with --jobs 2" in capsys.readouterr().err


def test_campaign_that_is_complete_runs_nothing_when_it_is_resumed(tmp_path, capsys) -> None:
    path = tmp_path / "f.json"
    common = {"seed": 0, "rtf": 2.0, "strategy": "time_optimal", "plant": "rolling", "rate": 20.0}
    write_json(path, [Outcome("pose_nan", 1.0, repetition=i) for i in range(2)], common)
    given = ["--json", str(path), "--fault", "pose_nan", "--repeat", "2", "--resume"]
    assert main(given) == 0
    assert "2 of 2 trials survived" in capsys.readouterr().out
    assert main([*given, "--seed", "1"]) == 1
    assert "'seed': 0" in capsys.readouterr().err


@pytest.mark.slow
def test_triple_is_survived_on_the_plant_with_contact(tmp_path, capsys, monkeypatch) -> None:
    pytest.importorskip("mujoco")
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)  # each job takes a domain of its own
    path = tmp_path / "faults.json"
    # At half the real time, as two of these simulations and their controllers share processors
    # with all the other tests.
    code = main(["--json", str(path), "--rtf", "0.5", "--plant", "rigid_body", "--jobs", "2",
                 "--triples", "1",
                 "--fault", "pose_nan", "controller_stopped", "burst_commands"])
    trials = json.loads(path.read_text())["trials"]
    triple = "pose_nan + burst_commands + controller_stopped"
    assert {trial["fault"] for trial in trials} == {*triple.split(" + "), triple}
    assert [trial["complaints"] for trial in trials] == [[]] * 4, capsys.readouterr().out
    assert code == 0


def test_folder_that_is_not_empty_is_left_alone(tmp_path, capsys) -> None:
    (tmp_path / "mine").write_text("mine")
    assert main(["--json", str(tmp_path / "f.json"), "--out", str(tmp_path)]) == 1
    assert "is not empty" in capsys.readouterr().err
