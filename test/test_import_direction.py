# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The rooms depend on each other in one direction: core, then simulation, then ROS and viewer."""

import ast
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CORE_NEEDS = {"numpy", "scipy", "casadi", "sphere_nmpc"} | sys.stdlib_module_names
ROS_NAMES = {"rclpy", "std_srvs", "rcl_interfaces", "builtin_interfaces", "tf2_ros", "rosbag2_py"}
EDGE_ROOMS = {
    "sphere_nmpc.ros", "sphere_sim.ros", "sphere_sim.viewer", "sphere_sim.cli", "sphere_sim.demo",
}


def imports_of(path: Path) -> Iterator[str]:
    """Yield the full names of what a module imports, at its top or inside a function."""
    package = path.relative_to(ROOT).parent.parts
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join((*base, *filter(None, [node.module])))
            yield from (f"{module}.{alias.name}" for alias in node.names)


def top(name: str) -> str:
    return name.partition(".")[0]


def is_ros(name: str) -> bool:
    return top(name) in ROS_NAMES or top(name).endswith("_msgs")


def room(path: Path) -> str:
    """Return the first two levels of a module, for example ``sphere_sim.ros``."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts[:2])


def in_room(name: str, rooms: set[str]) -> bool:
    return ".".join(name.split(".")[:2]) in rooms


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
    "nothing but the edge rooms imports the edge rooms": lambda here, name: (
        here not in EDGE_ROOMS and in_room(name, EDGE_ROOMS)
    ),
}


@pytest.mark.parametrize("rule", RULES)
def test_imports_follow_rule(rule: str) -> None:
    breaches = [
        f"{path.relative_to(ROOT)} imports {name}"
        for package in ("sphere_nmpc", "sphere_sim")
        for path in sorted((ROOT / package).rglob("*.py"))
        for name in imports_of(path)
        if RULES[rule](room(path), name)
    ]
    assert not breaches, f"{rule}:\n" + "\n".join(breaches)


def test_imports_of_resolves_relative_and_nested_imports(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    module = tmp_path / "sphere_nmpc" / "model" / "sphere.py"
    module.parent.mkdir(parents=True)
    module.write_text("from ..solver import solve\nfrom . import state\ndef f(): import rclpy\n")
    assert sorted(imports_of(module)) == [
        "rclpy",
        "sphere_nmpc.model.state",
        "sphere_nmpc.solver.solve",
    ]


def test_core_loads_nothing_beyond_its_needs(tmp_path) -> None:
    modules = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in sorted((ROOT / "sphere_nmpc").rglob("*.py"))
        if room(path) != "sphere_nmpc.ros" and path.name not in ("__init__.py", "__main__.py")
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
