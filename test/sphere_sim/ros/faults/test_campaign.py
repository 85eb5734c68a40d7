# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A short form of the campaign, over DDS: real nodes lose sight, are killed, cannot record."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from sphere_nmpc.model.parameters import RobotParameters

pytest.importorskip("rclpy")

from sphere_sim.cli.main import main as command

SHORT = ("pose_dropped_100", "pose_nan", "controller_killed", "disk_full")
ROBOT = RobotParameters()


def main(arguments: list[str]) -> int:
    """Run the verb as the command does."""
    return command(["faults", *arguments])


def campaign(folder: Path, faults: Sequence[str], seed: int) -> tuple[int, dict[str, dict]]:
    """Run some faults at the pace of the wall clock; return exit code and table."""
    path = folder / "faults.json"
    code = main(["--json", str(path), "--out", str(folder / "out"), "--rtf", "1",
                 "--seed", str(seed), "--fault", *faults])
    table = {row["fault"]: row for row in json.loads(path.read_text())["faults"]}
    assert list(table) == list(faults)
    for row in table.values():
        assert row["tried"] == 1
        assert 0.0 < row["worst_speed"] <= ROBOT.max_rotor_speed * 1.001
        assert 0.0 < row["worst_slew"] <= ROBOT.max_rotor_acceleration * 1.001
    assert code == (0 if all(row["survived"] for row in table.values()) else 1)
    return code, table


@pytest.mark.slow
def test_what_goes_wrong_is_survived_and_told(tmp_path, capsys) -> None:
    code, table = campaign(tmp_path / "first", SHORT, seed=3)
    told = capsys.readouterr().out
    for name, row in table.items():
        if row["survived"]:
            assert row["recover_s"] >= 0.0 and f"{name}: survived" in told
    if code:
        # Nodes that a busy machine holds up for seconds may have had bad luck, but not twice.
        again = [name for name, row in table.items() if not row["survived"]]
        code, _ = campaign(tmp_path / "second", again, seed=4)
    assert code == 0, told + capsys.readouterr().out


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (["--fault", "pose_lost"], "choose from"),
        (["--rtf", "50"], "expected 0.5 to 5"),
        (["--seed", "-1"], "expected a whole number from 0 on"),
        (["--repeat", "0"], "expected a whole number from 1 on"),
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
