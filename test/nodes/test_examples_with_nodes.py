# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Examples with simulator and controller as processes."""

import csv
import shutil
import subprocess
import sys
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from documented_examples import EXAMPLES, example_command, forms, printed, run_example
from launch_stand_in import ROOT
from patience import LOCKSTEP, PATIENCE
from ros_graph import started_pair

from sphere_sim.ros.session.process_set import parameter_options, verb_command

pytestmark = pytest.mark.slow

PATIENT = ("--ros-args", *parameter_options({"patience": PATIENCE}))
OWN_ROBOT = ("--params-file", "examples/own_robot.yaml")


def nodes(*options: str) -> AbstractContextManager[None]:
    """Run simulator and controller as fast as they can."""
    return started_pair(*options, simulator=LOCKSTEP | {"real_time_factor": 0.0},
                        controller={"goal_memory": 0.0})


def test_goals_are_reached_in_turn_also_if_the_nodes_start_later() -> None:
    command = example_command("go_and_wait.py", *PATIENT)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as client, nodes():
        output, _ = client.communicate(timeout=PATIENCE)
    assert client.returncode == 0
    (documented,) = printed("go_and_wait.py", "text")
    assert output.splitlines() and forms(output) <= forms(documented)


def test_robot_of_ones_own_goes_around_the_table_and_not_onto_it(monkeypatch) -> None:
    monkeypatch.chdir(ROOT)
    with nodes(*OWN_ROBOT):
        there = run_example("go_and_wait.py", "1.5", "0.5", "90", *PATIENT)
        assert there.returncode == 0, there.stderr
        onto = run_example("go_and_wait.py", "0", "0", *PATIENT)
    assert onto.returncode == 1
    assert onto.stderr == "goal [0.0, 0.0]: not reached: the goal: it is occupied\n"
    (documented,) = printed("own_robot.yaml", "text")
    assert forms(there.stdout + onto.stderr) == forms(documented)


def test_without_a_controller_the_reason_is_told() -> None:
    done = run_example("go_and_wait.py", "1", "0", "--ros-args", "-p", "patience:=0.5")
    assert done.returncode == 1
    assert done.stderr.endswith("there is no controller: nothing on controller/status\n")


@pytest.fixture(scope="module")
def packages(tmp_path_factory) -> Path:
    """Return a folder with the package of the examples, installed, and one that is faulty."""
    source, site = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("site")
    for name in ("setup.py", "own_strategy.py", "own_plant.py"):
        shutil.copy(EXAMPLES / name, source)
    pip = ("pip", "install", "--no-deps", "--no-build-isolation", "--no-index", "--target")
    done = subprocess.run(
        [sys.executable, "-m", *pip, str(site), str(source)], capture_output=True, text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (site / "faulty.py").write_text(
        "from own_plant import Lagging\nclass Sinking(Lagging):\n"
        "    def advance(self, speeds_end, duration):\n"
        "        super().advance(speeds_end, duration)\n        self.state[1] = float('nan')\n"
    )
    about = site / "faulty-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: faulty\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[sphere_nmpc.strategies]\nlost = faulty:Lost\npaper = own_strategy:RollTo\n"
        "[sphere_nmpc.plants]\nlost = faulty:Lost\nsinking = faulty:Sinking\n"
    )
    return site


@pytest.fixture
def installed(packages, monkeypatch) -> Path:
    """Return a folder with installed packages, which child processes find."""
    monkeypatch.setattr(sys, "path", [str(packages), *sys.path])
    return packages


def ended(verb: str, *options: str) -> subprocess.CompletedProcess[str]:
    """Run a verb that ends by itself."""
    return subprocess.run(
        verb_command(verb, *options), capture_output=True, text=True, timeout=PATIENCE,
        check=False,
    )


def test_nodes_run_strategy_and_plant_of_an_installed_package(installed) -> None:
    chosen = parameter_options({"strategy": "roll_to", "plant": "lagging", "lagging.lag": 0.03})
    with nodes(*chosen):
        done = run_example("go_and_wait.py", "1", "-1", *PATIENT)
    assert done.returncode == 0, done.stderr
    assert "goal [1.0, -1.0]: reached" in done.stdout


def test_study_runs_strategy_and_plant_of_an_installed_package(installed, tmp_path) -> None:
    out = tmp_path / "own"
    done = ended(
        "study", "--strategy", "roll_to", "--plant", "lagging", "--set", "lagging.lag=0.03",
        "--draw", "2", "--seed", "1", "--duration", "8", "--no-bound", "--jobs", "2",
        "--out", str(out),
    )
    assert done.returncode == 0, done.stderr
    with (out / "runs.csv").open(encoding="utf-8") as table:
        runs = list(csv.DictReader(table))
    assert [run["strategy"] for run in runs] == ["roll_to"] * 2
    assert not any(run["crash"] for run in runs)
    assert max(float(run["final_position_error_m"]) for run in runs) < 0.01


def test_plant_that_fails_ends_the_node_and_is_named(installed) -> None:
    done = ended("simulator", "--ros-args", *parameter_options({"plant": "sinking"}))
    assert done.returncode == 1
    (line,) = [line for line in done.stderr.splitlines() if "FATAL" in line]
    assert "plant sinking: state: given [2.0, nan, " in line
    assert line.endswith("], expected 6 finite numbers")
    rows = (ROOT / "docs" / "when_it_does_not_move.md").read_text(encoding="utf-8")
    assert "\n| plant …: state: given …, expected 6 finite numbers |" in rows


def test_plant_that_fails_does_not_begin_a_study_or_ends_its_runs(installed, tmp_path) -> None:
    for plant, code, words in (
        ("lost", 2, "plant: given 'faulty:Lost', expected a class that can be imported"),
        ("sinking", 1, "0 of 1 settled, 1 CRASHED"),
    ):
        options = ("--strategy", "paper", "--draw", "1", "--duration", "1", "--no-bound")
        done = ended("study", "--plant", plant, *options, "--out", str(tmp_path / plant))
        assert done.returncode == code and words in done.stdout + done.stderr
    assert "PlantError: plant sinking: state: " in (tmp_path / "sinking/runs.csv").read_text()


def test_strategy_that_cannot_be_loaded_is_named_with_the_reason(installed) -> None:
    done = ended("controller", "--ros-args", "-p", "strategy:=lost")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "strategy: given 'faulty:Lost', expected a class that can be imported" in line
