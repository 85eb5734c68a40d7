# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Imports go from the upper packages to the lower ones, and never to the working directory."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import import_graph
import pytest
from import_graph import FLOORS, SCOPES, TREES
from patience import PATIENCE

from sphere_nmpc.process.child import module_command, python_command

CORE_NEEDS = {"numpy", "scipy", "casadi", "sphere_nmpc"} | sys.stdlib_module_names
FILE_READERS = {"sphere_nmpc.floor", "sphere_nmpc.foreign"}
FILE_FORMATS = {"yaml", "PIL"}
ROS_NAMES = {
    "rclpy", "std_srvs", "rcl_interfaces", "builtin_interfaces", "type_description_interfaces",
    "tf2_ros", "rosbag2_py",
}


def top(name: str) -> str:
    return name.partition(".")[0]


def is_ros(name: str) -> bool:
    return top(name) in ROS_NAMES or top(name).endswith("_msgs")


RULES: dict[str, Callable[[str, str], bool]] = {
    "the core imports numpy, scipy, casadi, itself and readers of files only": lambda here, name: (
        top(here) == "sphere_nmpc" and here != "sphere_nmpc.ros" and top(name) not in CORE_NEEDS
        and not (here in FILE_READERS and top(name) in FILE_FORMATS)
    ),
    "rclpy and messages are imported in */ros only": lambda here, name: (
        not here.endswith(".ros") and is_ros(name)
    ),
    "viser is imported in sphere_sim/viewer only": lambda here, name: (
        here != "sphere_sim.viewer" and top(name) == "viser"
    ),
}


@pytest.mark.parametrize("rule", RULES)
def test_imports_of_other_projects_follow_rule(rule: str) -> None:
    breaches = [
        f"{module} imports {name}"
        for module, path in import_graph.sources().items()
        for name in import_graph.imports_of(path)
        if RULES[rule](import_graph.unit(module, ""), name)
    ]
    assert not breaches, f"{rule}:\n" + "\n".join(breaches)


def test_tables_and_drawing_in_the_document_are_those_of_the_code() -> None:
    text = import_graph.DOCUMENT.read_text(encoding="utf-8")
    # If the change is intended: python test/support/import_graph.py
    assert import_graph.updated(text) == text


def test_each_package_imports_from_lower_floors_only() -> None:
    order = {
        f"{tree}.{name}": (tree == TREES[0], number)
        for tree, floors in FLOORS.items() for number, floor in enumerate(floors) for name in floor
    }
    graph = import_graph.units_graph("")
    assert order.keys() == graph.keys(), "FLOORS in import_graph.py lists each package once"
    upward = [
        (here, to) for here, targets in graph.items() for to in targets if order[here] >= order[to]
    ]
    assert not upward


def test_no_circle_and_roots_that_import_nothing() -> None:
    """Each package may import the roots, which hence import nothing."""
    modules = import_graph.module_graph()
    for graph in (modules, *map(import_graph.units_graph, SCOPES)):
        assert not import_graph.circle(graph)
    assert not modules["sphere_nmpc"] and modules["sphere_sim"] == {"sphere_nmpc"}


def test_core_loads_nothing_beyond_its_needs(tmp_path) -> None:
    modules = [
        module for module in import_graph.sources()
        if top(module) == "sphere_nmpc" and import_graph.unit(module, "") != "sphere_nmpc.ros"
    ]
    script = (
        "import importlib, sys\n"
        f"for module in {modules}: importlib.import_module(module)\n"
        "print(*{'rclpy', 'sphere_sim', 'matplotlib', 'viser', 'mujoco'} & sys.modules.keys())"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == ""


# The first one is a module of Python that nothing imports at its start, unlike some others.
NAMES = ("tabnanny", "numpy", "re", "os", "sys", "subprocess", "selectors", "sphere_nmpc")
ROOT = Path(__file__).parents[2]


def test_children_of_python_are_started_in_one_place_only() -> None:
    users = {
        path.relative_to(ROOT).as_posix() for tree in ("sphere_nmpc", "sphere_sim", "launch")
        for path in (ROOT / tree).rglob("*.py") if "sys.executable" in path.read_text("utf-8")
    }
    assert users == {"sphere_nmpc/process/child.py"}


def test_child_imports_what_its_parent_imports_or_from_its_own_path(tmp_path, monkeypatch) -> None:
    hostile, beside = tmp_path / "bags", tmp_path / "beside"
    hostile.mkdir()
    for name in NAMES:
        (hostile / f"{name}.py").write_text("raise SystemExit(9)")
    beside.mkdir()
    (beside / "answer.py").write_text("def main(words): return len(words)")
    monkeypatch.syspath_prepend(beside)

    def run(command: list[str]) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command, cwd=hostile, capture_output=True, text=True, check=False, timeout=PATIENCE,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )

    assert run(module_command("answer", "a", "b c")).returncode == 2
    # Without the package's command the modules of the folder would be imported.
    assert run([sys.executable, "-c", "import tabnanny"]).returncode == 9
    program = "import tabnanny; print(sys.argv[1:], sys.path)"
    other = run(python_command(program, "x", python=sys.executable))
    assert other.returncode == 0
    assert other.stdout.startswith("['x'] ['") and str(beside) not in other.stdout


WITHOUT = """
import sys
sys.modules |= {"casadi": None, "scipy": None}  # as if they were not installed
import sphere_nmpc.ros.controller.node
from dataclasses import replace
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import run_scenario
for strategy in ("time_optimal", "plan_keeping", "paper"):
    settings = replace(StudyConditions().controller, strategy=strategy)
    run = run_scenario(StudyConditions(controller=settings, duration=1.0), PAPER_CASES[3])
    print(run.results["failures"], "crash" in run.results)
"""


def test_control_takes_neither_casadi_nor_scipy_where_the_solver_is_compiled() -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT], capture_output=True, text=True, timeout=PATIENCE,
        check=False,
    )
    assert done.stdout.split() == 3 * ["0", "False"], done.stdout + done.stderr
