# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Examples with simulator and controller as processes."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from documented_examples import EXAMPLES, example_command, forms, printed, run_example
from launch_stand_in import ROOT
from patience import LOCKSTEP, PATIENCE
from ros_graph import started, values_of

from sphere_nmpc.child import python_command
from sphere_sim.ros.session.process_set import parameter_options, verb_command

pytestmark = pytest.mark.slow

PATIENT = ("--ros-args", *parameter_options({"patience": PATIENCE}))
OWN_ROBOT = ("--params-file", "examples/own_robot.yaml")


@contextmanager
def nodes(*options: str) -> Iterator[None]:
    """Run simulator and controller as fast as they can."""
    given = {
        "simulator": {**LOCKSTEP, "real_time_factor": 0.0},
        "controller": {"use_sim_time": True, "lockstep": True, "goal_memory": 0.0},
    }
    with ExitStack() as processes:
        for verb, parameters in given.items():
            processes.enter_context(started(verb, *options, *parameter_options(parameters)))
        yield


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


@pytest.fixture
def installed(tmp_path, monkeypatch) -> Path:
    """Return a folder on the path of child processes with a package that brings strategies."""
    shutil.copy(EXAMPLES / "own_strategy.py", tmp_path)
    about = tmp_path / "own_strategy-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: own_strategy\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[sphere_nmpc.strategies]\nroll_to = own_strategy:RollTo\nlost = own_strategy:Lost\n"
        "paper = own_strategy:RollTo\n"
    )
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    return tmp_path


def test_node_finds_the_strategy_of_an_installed_package_by_its_name(graph, installed) -> None:
    statuses = graph.collect(DiagnosticStatus, "controller/status")
    with started("controller", "-p", "strategy:=roll_to"):
        graph.until(lambda: statuses)
    assert values_of(statuses[-1])["strategy"] == "roll_to"


def test_strategy_that_cannot_be_loaded_is_named_with_the_reason(installed) -> None:
    command = verb_command("controller", "--ros-args", "-p", "strategy:=lost")
    done = subprocess.run(
        command, stderr=subprocess.PIPE, text=True, timeout=PATIENCE, check=False
    )
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "strategy: given 'own_strategy:Lost', expected a class that can be imported" in line


def test_names_of_strategies_of_this_package_are_not_taken_by_others(installed) -> None:
    show = "from sphere_nmpc.settings import STRATEGIES as s; print(s['paper'].path, 'lost' in s)"
    done = subprocess.run(python_command(show), capture_output=True, text=True, check=True)
    assert done.stdout == "sphere_nmpc.strategy.paper:PaperStrategy True\n"
