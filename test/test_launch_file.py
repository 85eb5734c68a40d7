# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The launch file: what it starts is installed, and it can be read where launch exists."""

import ast
import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAUNCH = ROOT / "launch" / "sphere.launch.py"


def constants(name: str) -> tuple[str, ...]:
    for node in ast.parse(LAUNCH.read_text()).body:
        if isinstance(node, ast.Assign) and node.targets[0].id == name:
            return ast.literal_eval(node.value)
    raise AssertionError(f"{name} is not in {LAUNCH.name}")


def test_own_executables_are_installed() -> None:
    started = re.findall(r'package=PACKAGE, executable="(\w+)"', LAUNCH.read_text())
    scripts = re.findall(r'"(\w+) = [\w.]+:main"', (ROOT / "setup.py").read_text())
    assert started and set(started) <= set(scripts)


def test_recording_has_every_documented_topic() -> None:
    recorded = set(constants("RECORDED")) | set(constants("ABSOLUTE"))
    rows = re.findall(
        r"^\| `(\S+)` \| \S+ \| (?:publishes|subscribes)",
        (ROOT / "msg_docs" / "topics.md").read_text(), re.MULTILINE,
    )
    assert {row.replace("~", "controller") for row in rows} <= recorded


def test_description_is_generated_where_launch_is_installed() -> None:
    pytest.importorskip("launch_ros")
    ament = pytest.importorskip("ament_index_python.packages")
    try:
        ament.get_package_share_directory("sphere_nmpc")
    except ament.PackageNotFoundError:
        pytest.skip("the package itself is not installed in a colcon home")
    spec = spec_from_file_location("sphere_launch", LAUNCH)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    arguments = {entity.name for entity in module.generate_launch_description().entities[:-1]}
    assert arguments == {"namespace", "params_file", "use_sim_time", "record", "rviz", "viewer"}
