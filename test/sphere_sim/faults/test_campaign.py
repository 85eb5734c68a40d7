# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A short form of the campaign, over DDS: real nodes lose sight, are killed, cannot record."""

import json

import pytest

from sphere_nmpc.model.parameters import RobotParameters

pytest.importorskip("rclpy")

from sphere_sim.cli.faults import main

SHORT = ("pose_dropped_100", "pose_nan", "controller_killed", "solver_raises", "disk_full")


@pytest.mark.slow
def test_what_goes_wrong_is_survived_and_told(tmp_path, capsys) -> None:
    path = tmp_path / "faults.json"
    arguments = ["--json", str(path), "--fault", *SHORT, "--out", str(tmp_path / "out")]
    code = main([*arguments, "--seed", "3"])
    told = capsys.readouterr().out
    assert code == 0, told
    table = json.loads(path.read_text())["faults"]
    assert [row["fault"] for row in table] == list(SHORT)
    robot = RobotParameters()
    for row in table:
        assert row["tried"] == row["survived"] == 1
        assert row["recover_s"] >= 0.0
        assert 0.0 < row["worst_speed"] <= robot.max_rotor_speed * 1.001
        assert 0.0 < row["worst_slew"] <= robot.max_rotor_acceleration * 1.001
    assert f"{len(SHORT)} of {len(SHORT)} trials survived" in told


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (["--fault", "pose_lost"], "expected one of"),
        (["--rtf", "50"], "expected 0.5 to 5"),
        (["--seed", "-1"], "expected 0 or more"),
        (["--repeat", "0"], "expected 1 or more"),
    ],
)
def test_wrong_arguments_are_told_in_a_line(tmp_path, capsys, wrong, told) -> None:
    try:
        code = main(["--json", str(tmp_path / "f.json"), *wrong])
    except SystemExit as ended:
        code = ended.code
    assert code != 0
    assert told in capsys.readouterr().err
    assert not (tmp_path / "f.json").exists()


def test_folder_that_is_not_empty_is_left_alone(tmp_path, capsys) -> None:
    (tmp_path / "mine").write_text("mine")
    assert main(["--json", str(tmp_path / "f.json"), "--out", str(tmp_path)]) == 1
    assert "is not empty" in capsys.readouterr().err
