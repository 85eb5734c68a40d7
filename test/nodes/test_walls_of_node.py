# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Walls of the simulator over real DDS: maps that it takes and refuses, and contacts."""

import array
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64MultiArray

from sphere_nmpc.floor.occupancy import InvalidMapError
from sphere_sim.ros.simulator.node import SimulatorNode

pytestmark = pytest.mark.slow

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ORIGIN = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]


def simulator(graph, **settings) -> SimulatorNode:
    given = {"initial_state": ORIGIN, "real_time_factor": 5.0, "command_timeout": 5.0, **settings}
    node = SimulatorNode([Parameter(name, value=value) for name, value in given.items()])
    graph.add(node)
    return node


def room(side: float) -> OccupancyGrid:
    """Return a free square about the origin with a wall around it."""
    cells = np.zeros((20, 20), dtype=np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    message = OccupancyGrid(data=array.array("b", cells.tobytes()))
    message.info.width = message.info.height = 20
    message.info.resolution = side / 18
    message.info.origin.position.x = message.info.origin.position.y = -side * 10 / 18
    message.info.origin.orientation.w = 1.0
    return message


def clearance(node: SimulatorNode) -> float:
    return node.simulator.plant.contact.least_clearance(node.simulator.plant.state[None, :2])


@pytest.mark.parametrize("plant", ["rolling", "rigid_body"])
def test_map_makes_walls_that_are_touched_once_and_told(graph, capfd, plant) -> None:
    if plant == "rigid_body":
        pytest.importorskip("mujoco")
    node = simulator(graph, plant=plant)
    reports = graph.collect(DiagnosticArray, "/diagnostics")
    maps = graph.probe.create_publisher(OccupancyGrid, "map", LATCHED)
    assert node.simulator.touches == 0 and clearance(node) == np.inf
    maps.publish(room(1.8))
    graph.until(lambda: clearance(node) == pytest.approx(0.6, abs=0.01))
    bad = room(1.8)
    bad.info.width = 19
    maps.publish(bad)
    graph.until(lambda: node._fault_log.counts["map refused"] == 1)
    assert clearance(node) == pytest.approx(0.6, abs=0.01)
    speeds = graph.publisher(Float64MultiArray, "rotor_commands")
    speeds.publish(Float64MultiArray(data=[0.0, -60.0]))
    graph.until(lambda: node.simulator.touches == 1)
    assert clearance(node) > -2e-3

    def counted() -> bool:
        return any(
            ("wall touched", "1") in {(pair.key, pair.value) for pair in status.values}
            for report in reports for status in report.status
        )

    graph.until(counted)
    lines = [line for line in capfd.readouterr().err.splitlines() if "wall touched" in line]
    assert len(lines) == 1 and "1 contacts so far" in lines[0]


def test_change_of_walls_is_answered_when_they_stand_or_refused(graph) -> None:
    node = simulator(graph)
    for edge, radius in (("[[-1, -1], [1, -1], [1, 1], [-1, 1]]", 0.7), ("[[0, 0], [1, 1]]", 0.7)):
        value = Parameter("floor", value=edge).to_parameter_msg()
        request = SetParameters.Request(parameters=[value])
        (result,) = graph.call(SetParameters, "simulator/set_parameters", request).results
        assert result.successful is (len(edge) > 20)
        assert clearance(node) == pytest.approx(radius, abs=0.03)


@pytest.mark.parametrize("bad", [(2e6, 0.1), (0.0, 1e-30), (0.0, 1e30)])
def test_map_that_the_controller_refuses_is_refused_here_too(graph, bad) -> None:
    node = simulator(graph)
    maps = graph.probe.create_publisher(OccupancyGrid, "map", LATCHED)
    message = room(1.8)
    message.info.origin.position.x, message.info.resolution = bad
    maps.publish(message)
    graph.until(lambda: node._fault_log.counts["map refused"] == 1)
    maps.publish(room(1.8))
    graph.until(lambda: clearance(node) == pytest.approx(0.6, abs=0.01))


def test_map_file_makes_walls_from_the_start(graph, tmp_path) -> None:
    levels = np.full((20, 20), 254, dtype=np.uint8)
    levels[:, 18:] = 0
    (tmp_path / "room.pgm").write_bytes(b"P5\n20 20\n255\n" + levels.tobytes())
    file = tmp_path / "room.yaml"
    file.write_text("image: room.pgm\nresolution: 0.1\norigin: [-1, -1, 0]\nnegate: 0\n")
    node = simulator(graph, map_file=str(file), floor="[[-0.5, -1], [1, -1], [1, 1], [-0.5, 1]]")
    # The wall begins at x = 0.8 m, the edge of the floor at -0.5 m.
    assert clearance(node) == pytest.approx(0.2, abs=0.03)
    with pytest.raises(InvalidMapError, match=r"none\.yaml"):
        SimulatorNode([Parameter("map_file", value=str(Path(tmp_path) / "none.yaml"))])
