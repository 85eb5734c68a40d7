# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the nodes declare, what may change while they run, and what is refused."""

from dataclasses import dataclass

import navigation_messages
import pytest
from parameter_tables import NODES, OF_ROBOT, PARTS
from rclpy.node import Node
from rclpy.parameter import Parameter

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantity import quantities, quantity, validate
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.navigator.node import NavigatorNode
from sphere_nmpc.ros.parameters import Parameters
from sphere_nmpc.ros.settings import FrameSettings
from sphere_nmpc.settings import STRATEGIES, StrategyEntry
from sphere_sim.ros.recorder.node import RecorderNode
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.ros.simulator.settings import SimulatorNodeSettings

CLASSES = {
    "simulator": SimulatorNode, "controller": ControllerNode, "navigator": NavigatorNode,
    "recorder": RecorderNode,
}


@pytest.fixture
def controller(graph) -> ControllerNode:
    node = ControllerNode()
    graph.add(node)
    return node


@pytest.mark.parametrize("name", CLASSES)
def test_node_declares_each_quantity_with_unit_range_and_description(
    graph, name, tmp_path, monkeypatch
) -> None:
    navigation_messages.provide()
    monkeypatch.chdir(tmp_path)  # where the recorder begins a bag
    node = CLASSES[name]()
    graph.add(node)
    expected = {}
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


def test_change_to_a_strategy_that_cannot_be_loaded_leaves_the_one_in_force(
    controller, monkeypatch
) -> None:
    monkeypatch.setitem(STRATEGIES, "lost", StrategyEntry(0.25, "nowhere:Strategy"))
    result = controller.set_parameters([Parameter("strategy", value="lost")])[0]
    assert not result.successful and "No module named 'nowhere'" in result.reason
    assert controller.get_parameter("strategy").value == "time_optimal"


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
    node = SimulatorNode([Parameter(key, value=value) for key, value in given.items()])
    graph.add(node)
    lines = [line for line in capfd.readouterr().err.splitlines() if "unknown parameters" in line]
    assert len(lines) == 1 and "'robot.mass, sed'" in lines[0]
    assert not node.has_parameter("sed")


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
