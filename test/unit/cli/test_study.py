# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The verb ``study``: its output and its exit codes."""

import math
import os
from collections.abc import Iterator

import pytest

from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.cli.main import main as command
from sphere_sim.cli.study import _draws, _parser
from sphere_sim.scenario.perturbation import DisturbanceDraws
from sphere_sim.study.best_known import BestKnownTimes
from sphere_sim.study.motion import Motion
from sphere_sim.world.plant.rolling_plant import RollingPlant

BRIEF = ["--duration", "1", "--jobs", "1", "--no-bound"]


def main(arguments: list[str]) -> int:
    """Run the verb as the command does."""
    return command(["study", *arguments])


@pytest.fixture(autouse=True)
def no_figure(monkeypatch) -> None:
    monkeypatch.setattr("sphere_sim.study.study.draw", lambda *arguments: None)


@pytest.fixture(autouse=True)
def same_environment() -> Iterator[None]:
    """The verb pins the threads of numerical libraries for its process."""
    before = dict(os.environ)
    yield
    os.environ.clear()
    os.environ.update(before)


def test_disturbances_are_those_of_the_arguments() -> None:
    drawn = ["--push", "0.5", "0.2", "--push-time", "0.5", "--slope", "0.5", "--offset", "2"]
    given = _parser().parse_args(["--draw", "2", "--out", "out", *drawn])
    assert _draws(given) == DisturbanceDraws((0.2, 0.5), 0.5, math.radians(0.5), 2e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("", "--draw"), ("--draw 0", "given 0"), ("--draw 1000000000", "given 1000000000"),
        ("--draw 1 --scenarios a.csv", "not allowed with"),
        ("--draw 1 --duration 0", "--duration: given 0"),
        ("--draw 1 --pose-noise 1e999 0", "--pose-noise: given 1e999"),
        ("--draw 1 --push 1 2 3", "--push: given 3, expected one or two"),
        ("--draw 1 --slope 30", "--slope: given 30"),
        ("--draw 1 --set horizon", "--set: given horizon, expected NAME=VALUE"),
        ("--scenarios none.csv", "none.csv: given no such file"),
        ("--draw 1 --suite point-v1", "not allowed with"),
        ("--suite point-v1 --latency 0.1", "--suite: given 'point-v1', expected settings of the"),
        ("--suite point-v1 --push 1", "--suite: given 'point-v1', expected settings of the"),
        ("--draw 2 --perturb 91", "perturbation: given 91.0"),
        ("--draw 2 --set nothing=0 horizon=3", "nothing: given '0'"),
        ("--draw 2 --set pose_rate=50", "pose_rate: given '50', expected a setting"),
        ("--draw 2 --set horizon=6 horizon=8", "horizon: given ['6', '8']"),
        ("--draw 2 --strategy paper --set strategy=time_optimal",
         "controller.strategy: given ['paper', 'time_optimal'], expected one value"),
    ],
)
def test_invalid_study_exits_2_and_leaves_no_folder(tmp_path, capsys, arguments, words) -> None:
    out = tmp_path / "out"
    try:
        code: object = main([*arguments.split(), "--out", str(out), "--jobs", "1", "--no-bound"])
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_limits_that_contradict_each_other_are_told_once_at_the_start(tmp_path, caplog) -> None:
    pytest.importorskip("mujoco")
    weak = ["--draw", "1", "--plant", "rigid_body", "--set", "torque_limit=1.6"]
    both = ["--strategy", "paper", "plan_keeping"]
    assert main([*weak, *both, "--out", str(tmp_path / "out"), *BRIEF]) == 0
    (line,) = [text for text in caplog.messages if "torque_limit" in text]
    assert "1.6 N m" in line and "3.2 N m" in line


def test_folder_that_cannot_be_written_is_one_line_and_exits_2(tmp_path, capsys) -> None:
    out = tmp_path / "file"
    out.write_text("")
    assert main(["--draw", "1", "--out", str(out), *BRIEF]) == 2
    (message,) = capsys.readouterr().err.splitlines()
    assert f"{out}: " in message and "choose a folder that can be written" in message


def test_best_known_times_are_those_of_the_robot_that_is_set(tmp_path, monkeypatch) -> None:
    robots: list[RobotParameters] = []

    def search(motion: Motion, robot: RobotParameters, factor: float) -> BestKnownTimes:
        robots.append(robot)
        return BestKnownTimes(duration=2.0, settling=1.5)

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("sphere_sim.study.best_known.best_known_time", search)
    options = ["--draw", "1", "--kind", "half_turn", "--duration", "0.5", "--strategy", "paper"]
    options += ["--jobs", "1"]
    robot = ["--set", "robot.shell_mass=1.5", "max_rotor_speed=60"]
    assert main([*options, *robot, "--out", str(tmp_path / "out")]) == 0
    assert robots == [RobotParameters(shell_mass=1.5, max_rotor_speed=60.0)]


def test_runs_that_crash_exit_1(tmp_path, monkeypatch, capsys) -> None:
    def fail(self: object, end: object, duration: float) -> None:
        raise ArithmeticError

    monkeypatch.setattr(RollingPlant, "advance", fail)
    assert main(["--draw", "1", "--out", str(tmp_path), *BRIEF]) == 1
    assert "1 CRASHED" in capsys.readouterr().out
