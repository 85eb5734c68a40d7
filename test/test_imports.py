# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Imports go from the upper packages to the lower ones, as the tables in CONTRIBUTING.md say."""

import subprocess
import sys
from collections.abc import Callable

import import_graph
import pytest
from import_graph import DOCUMENT, FLOORS, SCOPES, TREES

UPDATE = "if the change is intended: python test/support/import_graph.py"
CORE_NEEDS = {"numpy", "scipy", "casadi", "sphere_nmpc"} | sys.stdlib_module_names
ROS_NAMES = {
    "rclpy", "std_srvs", "rcl_interfaces", "builtin_interfaces", "type_description_interfaces",
    "tf2_ros", "rosbag2_py",
}


def top(name: str) -> str:
    return name.partition(".")[0]


def is_ros(name: str) -> bool:
    return top(name) in ROS_NAMES or top(name).endswith("_msgs")


RULES: dict[str, Callable[[str, str], bool]] = {
    "the core imports numpy, scipy, casadi and itself only": lambda here, name: (
        top(here) == "sphere_nmpc" and here != "sphere_nmpc.ros" and top(name) not in CORE_NEEDS
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


def arrows(graph: import_graph.Graph) -> set[tuple[str, str]]:
    return {(here, target) for here, targets in graph.items() for target in targets}


@pytest.mark.parametrize("scope", SCOPES)
def test_each_import_between_packages_is_in_the_table(scope: str) -> None:
    beyond = arrows(import_graph.units_graph(scope)) - arrows(import_graph.documented(scope))
    assert not beyond, f"imports that CONTRIBUTING.md does not allow; {UPDATE}"


@pytest.mark.parametrize("scope", SCOPES)
def test_the_table_lists_each_package_and_existing_imports_only(scope: str) -> None:
    graph, documented = import_graph.units_graph(scope), import_graph.documented(scope)
    assert documented.keys() == graph.keys(), UPDATE
    assert not arrows(documented) - arrows(graph), f"entries without an import; {UPDATE}"


def test_drawing_shows_the_imports() -> None:
    assert import_graph.drawing() in DOCUMENT.read_text(encoding="utf-8"), UPDATE


def test_each_package_imports_from_lower_floors_only() -> None:
    order = {
        f"{tree}.{name}": (TREES.index(tree) == 0, number)
        for tree, floors in FLOORS.items()
        for number, floor in enumerate(floors)
        for name in floor
    }
    graph = import_graph.units_graph("")
    assert order.keys() == graph.keys(), "FLOORS in import_graph.py lists each package once"
    upward = [(here, to) for here, to in arrows(graph) if order[here] >= order[to]]
    assert not upward


@pytest.mark.parametrize("scope", SCOPES)
def test_no_circle_between_packages(scope: str) -> None:
    assert not import_graph.circle(import_graph.units_graph(scope))


def test_no_circle_between_modules() -> None:
    assert not import_graph.circle(import_graph.module_graph())


@pytest.mark.parametrize("tree", TREES)
def test_each_package_may_import_the_roots_as_they_import_nothing(tree: str) -> None:
    assert not import_graph.module_graph()[tree]


def test_imports_of_resolves_relative_and_nested_imports(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(import_graph, "ROOT", tmp_path)
    module = tmp_path / "sphere_nmpc" / "model" / "sphere.py"
    module.parent.mkdir(parents=True)
    module.write_text("from ..solver import solve\nfrom . import state\ndef f(): import rclpy\n")
    assert sorted(import_graph.imports_of(module)) == [
        "rclpy",
        "sphere_nmpc.model.state",
        "sphere_nmpc.solver.solve",
    ]


def test_circle_is_found_and_named() -> None:
    graph = {"a": {"b"}, "b": {"c", "d"}, "c": set(), "d": {"b"}}
    assert import_graph.circle(graph) == ["b", "d", "b"]
    assert import_graph.circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_core_loads_nothing_beyond_its_needs(tmp_path) -> None:
    modules = [
        module
        for module, path in import_graph.sources().items()
        if top(module) == "sphere_nmpc"
        and import_graph.unit(module, "") != "sphere_nmpc.ros"
        and path.name != "__main__.py"
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
