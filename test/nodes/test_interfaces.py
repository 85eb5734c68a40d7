# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the nodes declare, subscribe to, publish and answer, as it is documented."""

import json
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import navigation_messages
import pytest
import yaml
from documented_topics import table
from parameter_tables import NODES, OF_ROBOT, PARTS
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.subscription import Subscription
from ros_graph import Graph, running_graph

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantities import quantities, quantity, validate
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.navigator.node import NavigatorNode
from sphere_nmpc.ros.navigator.substitutes import SERVICES
from sphere_nmpc.ros.odometry.node import OdometryNode
from sphere_nmpc.ros.parameters import Parameters
from sphere_nmpc.ros.settings import FrameSettings
from sphere_nmpc.settings import STRATEGIES, StrategyEntry
from sphere_sim.ros.recorder.node import RecorderNode
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.ros.simulator.settings import SimulatorNodeSettings

ROOT = Path(__file__).parents[2]
CLASSES: dict[str, Any] = {
    "simulator": SimulatorNode, "controller": ControllerNode, "odometry": OdometryNode,
    "navigator": NavigatorNode, "recorder": RecorderNode,
}
SHARED = {"/clock", "/diagnostics"}
"""Topics that precede every namespace; without the nodes' remapping /clock is one of them."""
ELSEWHERE = re.compile("|".join((
    "/rosout", "/parameter_events", "/tf", ".*parameter", ".*type_description",
    *(f".*/{name}$" for name in SERVICES),
)))
"""Topics and services of rclpy, and those that depend on what is installed and runs."""


@pytest.fixture(scope="module")
def graph(tmp_path_factory) -> Iterator[Graph]:
    """Return a graph in a namespace."""
    navigation_messages.provide()
    with pytest.MonkeyPatch.context() as patch, running_graph(
        ["--ros-args", "-r", "__ns:=/second"]
    ) as graph:
        patch.chdir(tmp_path_factory.mktemp("bags"))  # where the recorder begins one
        yield graph


@pytest.fixture(scope="module")
def nodes(graph) -> dict[str, Any]:
    return {name: graph.start(kind) for name, kind in CLASSES.items()}


@pytest.fixture
def controller(nodes) -> ControllerNode:
    return nodes["controller"]


def type_name(message) -> str:
    package, kind, _ = message.__module__.split(".")
    return f"{package}/{kind}/{message.__name__}"


def offered(node) -> set[tuple[str, str, str, str]]:
    """Return (full name, type, kind, QoS) of each topic and service of a node."""
    rows = set()
    for end in (*node.publishers, *node.subscriptions):
        profile = end.qos_profile
        parts = [
            "reliable" if profile.reliability == ReliabilityPolicy.RELIABLE else "best effort",
            str(profile.depth),
        ]
        if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            parts.append("transient local")
        kind = "subscribes" if isinstance(end, Subscription) else "publishes"
        rows.add((end.topic_name, type_name(end.msg_type), kind, ", ".join(parts)))
    rows |= {(it.service_name, type_name(it.srv_type), "service", "") for it in node.services}
    return {row for row in rows if not ELSEWHERE.match(row[0])}


@pytest.mark.parametrize("name", CLASSES)
def test_tables_agree_with_the_node_which_may_be_in_a_namespace(nodes, name) -> None:
    documented = {
        (topic if topic in SHARED else f"/second{topic}", *rest)
        for owner, topic, *rest in table() if owner == name and rest[1] != "action"
    }
    assert offered(nodes[name]) == documented


OF_TOOLS = {"/markers"}
"""Topics of the marker node."""


def strings(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    for part in (*value, *value.values()) if isinstance(value, dict) else ():
        yield from strings(part)
    for part in value if isinstance(value, list) else ():
        yield from strings(part)


def test_rviz_and_foxglove_show_documented_topics() -> None:
    documented = {topic for _, topic, *_ in table()} | OF_TOOLS
    manager = yaml.safe_load((ROOT / "rviz" / "sphere.rviz").read_text())["Visualization Manager"]
    topics = {
        "/" + entry[key]["Value"].lstrip("/")
        for entry in (*manager["Displays"], *manager["Tools"])
        for key in ("Topic", "Description Topic") if key in entry
    }
    assert topics <= documented
    assert {"/pose", "/odom", "/markers", "/goal_pose", "/controller/predicted_path"} <= topics
    assert manager["Global Options"]["Fixed Frame"] == "world"
    layout = json.loads((ROOT / "foxglove" / "sphere.json").read_text())
    shown = {text.partition(".")[0] for text in strings(layout) if re.match(r"/[a-z]", text)}
    assert shown <= documented
    placed = [text for text in strings(layout["layout"]) if text in layout["configById"]]
    assert sorted(placed) == sorted(layout["configById"]), "every panel has one place"


@pytest.mark.parametrize("name", CLASSES)
def test_node_declares_each_quantity_with_unit_range_and_description(nodes, name) -> None:
    node, expected = nodes[name], {}
    robot = [("robot", RobotParameters())] if name in OF_ROBOT else []
    for prefix, part in [("", NODES[name]), *robot, *((p, part) for p, _, part in PARTS[name])]:
        expected |= {f"{prefix}.{key}".lstrip("."): v for key, v in quantities(part).items()}
    declared = set(node.list_parameters([], depth=0).names)
    assert declared - expected.keys() <= {"use_sim_time", "start_type_description_service"}
    for key, about in expected.items():
        descriptor = node.describe_parameter(key)
        assert about.description in descriptor.description
        assert descriptor.read_only is not about.live
        if about.unit != "-":
            assert f"[{about.unit}]" in descriptor.description
        if about.minimum is not None:
            (bounds,) = descriptor.floating_point_range or descriptor.integer_range
            assert (bounds.from_value, bounds.to_value) == (about.minimum, about.maximum)
        for choice in about.choices:
            assert choice in descriptor.additional_constraints


@pytest.mark.parametrize(
    "name, value, words",
    [
        ("horizon", 8, "read-only"),
        ("robot.shell_mass", 2.0, "read-only"),
        ("input_weight", -1.0, "0"),
        ("input_weight", "much", "type"),
        ("max_iterations", 1.5, "type"),
        ("pose_timeout", float("nan"), "pose_timeout"),
    ],
)
def test_wrong_change_is_refused_with_the_reason(controller, name, value, words) -> None:
    before = controller.get_parameter(name).value
    result = controller.set_parameters([Parameter(name, value=value)])[0]
    assert not result.successful
    assert words in result.reason
    assert controller.get_parameter(name).value == before


@pytest.mark.slow
@pytest.mark.parametrize("name", CLASSES)
def test_values_that_a_node_has_can_be_loaded_again(graph, nodes, name) -> None:
    names = sorted(nodes[name].list_parameters([], depth=0).names)
    path = f"/second/{name}"
    found = graph.call(GetParameters, f"{path}/get_parameters", names=names)
    dumped = [
        ParameterMessage(name=one, value=value)
        for one, value in zip(names, found.values, strict=True)
    ]
    kinds = {SetParameters: "set_parameters", SetParametersAtomically: "set_parameters_atomically"}
    for kind, service in kinds.items():
        answer = graph.call(kind, f"{path}/{service}", parameters=dumped)
        results = getattr(answer, "results", None) or [answer.result]
        assert [one.reason for one in results if not one.successful] == []
        assert len(results) == (len(names) if kind is SetParameters else 1)


@pytest.mark.parametrize("horizon", [8, 8.0])
def test_other_value_of_a_read_only_parameter_is_refused_by_the_service(
    graph, controller, horizon
) -> None:
    given = [Parameter("horizon", value=horizon).to_parameter_msg()]
    kind, name = SetParametersAtomically, "/second/controller/set_parameters_atomically"
    result = graph.call(kind, name, parameters=given).result
    assert not result.successful and "read-only" in result.reason


def test_change_to_a_strategy_that_cannot_be_loaded_leaves_the_one_in_force(
    controller, monkeypatch
) -> None:
    monkeypatch.setitem(STRATEGIES, "lost", StrategyEntry("nowhere:Strategy"))
    result = controller.set_parameters([Parameter("strategy", value="lost")])[0]
    assert not result.successful and "No module named 'nowhere'" in result.reason
    assert controller.get_parameter("strategy").value == "time_optimal"


class Unmakeable:
    """Strategy that ends the process where it is made."""

    def __init__(self, *arguments: object) -> None:
        sys.exit(3)

    def plan(self) -> None: ...
    def change(self) -> None: ...
    def reset(self) -> None: ...


def test_change_to_a_strategy_that_cannot_be_made_leaves_the_one_in_force(
    controller, monkeypatch
) -> None:
    monkeypatch.setitem(STRATEGIES, "unmakeable", StrategyEntry(f"{__name__}:Unmakeable"))
    result = controller.set_parameters([Parameter("strategy", value="unmakeable")])[0]
    assert not result.successful
    assert result.reason.endswith("expected one that can be made (SystemExit '3')")
    assert controller.get_parameter("strategy").value == "time_optimal"
    assert controller.controller.failures == 0


@dataclass(frozen=True)
class Band:
    """Settings that are valid only together."""

    low: float = quantity(1.0, "m", "Lower end", live=True)
    high: float = quantity(2.0, "m", "Upper end", live=True)

    def __post_init__(self) -> None:
        validate(self)
        if self.low >= self.high:
            raise InvalidParameterError("low", self.low, f"less than high = {self.high:g}")


def test_settings_that_depend_on_each_other_change_at_once_in_any_order(graph) -> None:
    band = {"low": -3.0, "high": -2.0}
    given = [Parameter("low", value=7.0), Parameter("high", value=8.0)]
    for turn in (1, -1):
        node = Node(
            f"band{turn + 1}",
            parameter_overrides=given[::turn],
            automatically_declare_parameters_from_overrides=True,
        )
        declared = Parameters(node).declare(Band())
        assert declared.settings == Band(7.0, 8.0)
        changes = [Parameter(name, value=value) for name, value in band.items()][::turn]
        result = node.set_parameters_atomically(changes)
        assert result.successful, result.reason
        assert declared.settings == Band(**band)
        refused = node.set_parameters_atomically([Parameter("low", value=9.0)])
        assert not refused.successful and "less than high" in refused.reason
        node.destroy_node()


def test_unknown_names_are_logged_in_one_warning_and_a_wrong_value_is_named(
    graph, capfd
) -> None:
    with pytest.raises(InvalidParameterError, match=r"initial_state: given .*, expected"):
        SimulatorNode([Parameter("initial_state", value=[1.0, 2.0])])
    given = {"sed": 1, "robot.mass": 2.0}
    node = graph.start(SimulatorNode, **given)
    lines = [line for line in capfd.readouterr().err.splitlines() if "unknown parameters" in line]
    assert len(lines) == 1 and "'robot.mass, sed'" in lines[0]
    assert not node.has_parameter("sed")


def test_robot_may_be_given_to_a_node_without_need_of_it(graph, capfd) -> None:
    node = graph.start(RecorderNode, **{"robot.shell_mass": 2.0, "robot.mass": 2.0})
    (line,) = (line for line in capfd.readouterr().err.splitlines() if "unknown" in line)
    assert "'robot.mass'" in line and not node.has_parameter("robot.shell_mass")


@pytest.mark.parametrize(
    ("settings", "values", "words"),
    [
        (SimulatorNodeSettings, {"real_time_factor": -1.0}, "expected 0 to 1000"),
        (SimulatorNodeSettings, {"clock": "system", "real_time_factor": 2.0}, "expected 1.0 with"),
        (SimulatorNodeSettings, {"initial_state": (1.0, 2.0)}, "expected 6 numbers"),
        (FrameSettings, {"world_frame": "/map"}, "expected a name that begins without /"),
    ],
)
def test_settings_of_a_node_that_cannot_be_used_are_refused(settings, values, words) -> None:
    with pytest.raises(InvalidParameterError, match=words):
        settings(**values)
