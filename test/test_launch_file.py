# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The launch file, checked against the package wherever launch itself is not installed."""

import ast
import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAUNCH = ROOT / "launch" / "sphere.launch.py"
TREE = ast.parse(LAUNCH.read_text())
ARGUMENTS = {"namespace", "params_file", "use_sim_time", "record", "rviz", "viewer"}
KNOWN = {
    "Node": {
        "executable", "package", "name", "namespace", "exec_name", "parameters", "remappings",
        "ros_arguments", "arguments", "output",
    },
    "ExecuteProcess": {"cmd", "output"},
    "DeclareLaunchArgument": {"name", "default_value", "description", "choices"},
    "LogInfo": {"msg"},
    "OpaqueFunction": {"function"},
    "ParameterValue": {"value_type"},
}
"""Keywords of launch and launch_ros in Jazzy."""


def calls(name: str) -> list[ast.Call]:
    """Return the calls of a function of launch."""
    return [
        node for node in ast.walk(TREE)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == name
    ]


def given(call: ast.Call) -> dict[str, str]:
    """Return the keywords of a call with their values as they are written."""
    spread = {}
    for keyword in call.keywords:
        if keyword.arg is None:  # **common
            (common,) = (
                node.value for node in ast.walk(TREE) if isinstance(node, ast.Assign)
                and getattr(node.targets[0], "id", "") == keyword.value.id
            )
            pairs = zip(common.keys, common.values, strict=True)
            spread |= {key.value: ast.unparse(value) for key, value in pairs}
        else:
            spread[keyword.arg] = ast.unparse(keyword.value)
    return spread


def constants(name: str) -> tuple[str, ...]:
    for node in TREE.body:
        if isinstance(node, ast.Assign) and node.targets[0].id == name:
            return ast.literal_eval(node.value)
    raise AssertionError(f"{name} is not in {LAUNCH.name}")


@pytest.mark.parametrize("name", KNOWN)
def test_launch_is_called_with_keywords_it_knows(name) -> None:
    assert calls(name)
    for call in calls(name):
        assert given(call).keys() <= KNOWN[name], ast.unparse(call)


def test_own_executables_are_installed() -> None:
    nodes = [given(call) for call in calls("Node")]
    started = {ast.literal_eval(n["executable"]) for n in nodes if n["package"] == "PACKAGE"}
    scripts = re.findall(r'"(\w+) = [\w.]+:main"', (ROOT / "setup.py").read_text())
    assert started == {"simulator", "controller", "recorder", "viewer", "markers"}
    assert started <= set(scripts)


def test_packages_of_others_are_asked_for_before_they_are_used() -> None:
    nodes = [given(call) for call in calls("Node")]
    others = {ast.literal_eval(n["package"]) for n in nodes if n["package"] != "PACKAGE"}
    asked = {ast.literal_eval(call.args[0]) for call in calls("is_installed")}
    assert others == {"robot_state_publisher", "rviz2"}
    assert others <= asked and {"ros2bag", "rosbag2_storage_mcap"} <= asked


def test_every_node_is_in_the_namespace_and_only_the_simulator_without_its_clock() -> None:
    for node in map(given, calls("Node")):
        assert node["namespace"] == "namespace"
        # Viewer and markers go by the wall: what stands still is to be seen as well.
        own_clock = node["executable"] in ("'simulator'", "'viewer'", "'markers'")
        assert own_clock or "clock" in node["parameters"]


def test_files_that_are_named_are_installed() -> None:
    named = re.findall(r'share / "(\w+)" / "([\w.]+)"', LAUNCH.read_text())
    named += re.findall(r'\(PACKAGE\), "(\w+)", "([\w.]+)"', LAUNCH.read_text())
    assert set(named) == {
        ("urdf", "sphere.urdf"), ("rviz", "sphere.rviz"), ("config", "sphere.yaml")
    }
    for folder, file in named:
        assert (ROOT / folder / file).is_file()


def test_arguments_that_are_read_are_declared() -> None:
    declared = {ast.literal_eval(call.args[0]) for call in calls("DeclareLaunchArgument")}
    used = {m for m in re.findall(r'value\["(\w+)"\]', LAUNCH.read_text())}
    (read,) = (
        ast.literal_eval(node.generators[0].iter) for node in ast.walk(TREE)
        if isinstance(node, ast.DictComp)
    )
    assert declared == used == set(read) == ARGUMENTS


def test_robot_description_is_a_text_to_launch() -> None:
    (call,) = calls("ParameterValue")
    assert given(call)["value_type"] == "str"
    assert "'robot_description': text" in ast.unparse(TREE)


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
    assert arguments == ARGUMENTS
