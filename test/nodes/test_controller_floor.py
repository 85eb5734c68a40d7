# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The floor of the controller node over real DDS: maps, areas to keep out of, and parameters."""

import array
import gc
import math
import os
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point32, PolygonInstanceStamped
from nav_msgs.msg import OccupancyGrid
from patience import PATIENCE
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import Graph, forget_faults, parameters_of, running_graph, values_of

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import InvalidMapError
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.guarded_node import LATCHED

pytestmark = pytest.mark.slow

KEPT = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SQUARE = [(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)]
EDGE = "[[0, 0], [2, 0], [2, 3], [0, 3]]"
DEFAULTS = {"floor": "", "map_file": "", "clearance": 0.03, "occupied_threshold": 0.65,
            "unknown_is_free": False}


def map_message(resolution: float = 0.1, value: int = 0) -> OccupancyGrid:
    """Return a map of 40 x 30 cells whose first column is occupied and whose last is unknown."""
    values = np.full((30, 40), value, dtype=np.int8)
    values[:, 0], values[:, -1] = 100, -1
    message = OccupancyGrid(data=array.array("b", values.tobytes()))
    message.header.frame_id = "world"
    message.info.height, message.info.width = values.shape
    message.info.resolution = resolution
    message.info.origin.orientation.w = 1.0
    return message


def area(number: int, corners: list, x: float = 0.0, frame: str = "") -> PolygonInstanceStamped:
    message = PolygonInstanceStamped()
    message.header.frame_id = frame
    message.polygon.id = number
    message.polygon.polygon.points = [Point32(x=x + left, y=y) for left, y in corners]
    return message


def map_file(folder: Path, name: str = "hall") -> Path:
    """Write a map file of 2 m x 1 m whose left half is free."""
    rows = b"\xff" * 10 + b"\x00" * 10
    (folder / f"{name}.pgm").write_bytes(b"P5 20 10 255\n" + rows * 10)
    file = folder / f"{name}.yaml"
    file.write_text(f"image: {name}.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n")
    return file


def distance(node: ControllerNode, x: float, y: float) -> float:
    return float(node.controller.floor.distances(np.array([[x, y]]))[0])


class Floors:
    """A controller node, its floor, and publishers of what it is made of."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.node = graph.start(ControllerNode)
        self.shown: list[OccupancyGrid] = graph.collect(
            OccupancyGrid, "controller/floor", LATCHED
        )
        self.statuses = graph.collect(DiagnosticStatus, "controller/status")
        self.maps = graph.probe.create_publisher(OccupancyGrid, "map", LATCHED)
        self.areas = graph.probe.create_publisher(PolygonInstanceStamped, "keepout", KEPT)
        graph.until(lambda: self.statuses and self.maps.get_subscription_count()
                    and self.areas.get_subscription_count())
        self.begins_without = self.floor is None and not self.shown and not threads()

    @property
    def floor(self) -> Any:
        floor = self.node.controller.floor
        return None if floor.is_empty else floor

    def publish(self, *messages: Any) -> Any:
        """Publish maps and areas, and return the new floor that they lead to."""
        before = self.floor
        for message in messages:
            (self.maps if isinstance(message, OccupancyGrid) else self.areas).publish(message)
        self.graph.until(lambda: self.floor is not before)
        return self.floor

    def set(self, **values: Any) -> Any:
        """Return the answer to a change of parameters, which waits for the floor."""
        return self.node.set_parameters_atomically(parameters_of(values))

    def asked(self, kind: Any = SetParameters, **values: Any) -> Any:
        """Return the future of the answer to a request to change parameters."""
        name = "set_parameters" + "_atomically" * (kind is SetParametersAtomically)
        changes = [parameter.to_parameter_msg() for parameter in parameters_of(values)]
        return self.graph.ask(kind, f"controller/{name}", parameters=changes)

    def refused(self, kind: str) -> int:
        return self.node._fault_log.counts[f"{kind} refused"]

    def remove(self) -> None:
        """Return to the parameters of the start, without a map and areas."""
        assert self.set(**DEFAULTS).successful
        for number in range(10):
            self.areas.publish(area(number, []))
        self.graph.until(lambda: self.floor is None and not self.node._floor_receiver.pending)
        self.shown.clear()
        forget_faults(self.node)


def threads() -> list[threading.Thread]:
    """Return the threads in which floors are made."""
    return [one for one in threading.enumerate() if one.name == "floor"]


@pytest.fixture(scope="module")
def shared() -> Iterator[Floors]:
    with running_graph() as graph:
        yield Floors(graph)


@pytest.fixture
def floors(shared) -> Iterator[Floors]:
    """Return a controller without a floor."""
    yield shared
    shared.graph.unforeseen.clear()
    shared.remove()


def test_without_a_map_there_is_no_floor_and_none_is_shown(floors) -> None:
    assert floors.begins_without


def test_map_is_taken_and_shown(floors, capfd) -> None:
    given = map_message()
    given.info.origin.position.x = -1.0
    given.info.origin.orientation.z = given.info.origin.orientation.w = math.sqrt(0.5)
    floor = floors.publish(given)
    assert floor.radius == 0.3 and floor.clearance == 0.03
    assert "corner_distances" in vars(floor), "nothing is left for the control loop to compute"
    # The grid's x axis is the world's y axis: from y = 0.1 to 3.9 it is free, and to x = -4.
    assert distance(floors.node, -2.0, 1.1) == pytest.approx(1.0, abs=0.05)
    assert distance(floors.node, -2.0, 3.8) == pytest.approx(0.1, abs=0.05)
    assert distance(floors.node, -0.9, 2.0) == 0.0
    floors.graph.until(lambda: floors.shown)
    (shown,) = floors.shown
    assert shown.header.frame_id == "world" and shown.info.origin.position.x == -1.0
    assert shown.info.origin.orientation.z == pytest.approx(math.sqrt(0.5))
    assert shown.info.resolution == pytest.approx(0.1, rel=1e-6)
    values = np.array(shown.data).reshape(shown.info.height, shown.info.width)
    expected = np.zeros((30, 40))
    expected[:, 0] = expected[:, -1] = 100
    np.testing.assert_array_equal(values, expected)
    line = r"floor: 40 x 30 cells of 0.1 m, 4 m x 3 m, 95 % free, in force after \d+\.\d\d s"
    assert len(re.findall(line, capfd.readouterr().err)) == 1


def test_late_starter_uses_its_file_until_it_takes_what_was_published_before(
    floors, tmp_path
) -> None:
    floors.publish(map_message(), *(area(number, SQUARE, number) for number in range(3)))
    node = ControllerNode([Parameter("map_file", value=str(map_file(tmp_path)))])
    floors.graph.add(node)
    assert distance(node, 0.5, 0.5) > 0.4 and distance(node, 1.5, 0.5) == 0.0
    floors.graph.until(lambda: distance(node, 2.5, 0.5) > 0.0)
    floors.graph.until(lambda: not any(distance(node, x, 1.5) for x in (1.5, 2.5, 3.5)))
    floors.graph.remove(node)


def test_areas_to_keep_out_of_are_added_replaced_and_removed(floors) -> None:
    floors.publish(area(7, SQUARE))
    assert distance(floors.node, 1.5, 1.5) == 0.0
    assert distance(floors.node, 0.0, 1.5) == pytest.approx(1.0, abs=0.05)
    floors.publish(area(7, SQUARE, 2.0))
    assert distance(floors.node, 1.5, 1.5) > 0.4 and distance(floors.node, 3.5, 1.5) == 0.0
    kept = floors.publish(area(8, SQUARE))
    floors.areas.publish(area(8, SQUARE, frame="world"))
    floors.areas.publish(area(9, []))
    floors.graph.spin_for(0.5)
    assert floors.floor is kept, "what changes nothing leaves the floor as it is"
    floors.publish(area(7, []))
    assert distance(floors.node, 3.5, 1.5) > 0.0 and distance(floors.node, 1.5, 1.5) == 0.0
    assert floors.publish(area(8, [])) is None
    floors.graph.until(lambda: floors.shown[-1].info.width == 0)


def of_another_frame() -> OccupancyGrid:
    message = map_message()
    message.header.frame_id = "odom"
    return message


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (map_message(value=101), "map: given a value of 101, expected -1 (unknown)"),
        (map_message(1e-30), "map: given a resolution of 1e-30 m, expected a positive number"),
        (of_another_frame(), "map: given frame odom, expected 'world' (world_frame) or none"),
        (area(3, [(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]),
         "keepout 3: given edges 0 and 2 that cross, expected a simple polygon"),
        (area(3, SQUARE, frame="odom"), "keepout: given frame odom, expected 'world'"),
        (area(2, SQUARE, 1e5), "keepout 2: given a floor of 1.0"),
        (area(1, [(0.0, 0.0)] * 20_000),
         "keepout: given 240036 bytes, expected at most 5000 corners"),
    ],
    ids=["value", "cells", "frame", "edges", "frame of an area", "far away", "corners"],
)
def test_bad_map_or_area_is_refused_alone_with_one_line(floors, capfd, message, told) -> None:
    floor = floors.publish(area(3, SQUARE))
    kind = "map" if isinstance(message, OccupancyGrid) else "keepout"
    (floors.maps if kind == "map" else floors.areas).publish(message)
    floors.graph.until(lambda: floors.refused(kind) == 1)
    (line,) = (line for line in capfd.readouterr().err.splitlines() if "refused" in line)
    assert f"{kind} refused: {told}" in line
    assert floors.floor is floor
    floors.publish(map_message())


def test_parameters_of_the_floor_are_live(floors) -> None:
    node = floors.node
    assert floors.set(clearance=0.1).successful
    floors.publish(map_message(value=50))
    assert floors.floor.clearance == 0.1 and distance(node, 2.0, 1.5) > 1.0
    floors.set(clearance=0.3, occupied_threshold=0.5)
    assert floors.floor.clearance == 0.3 and distance(node, 2.0, 1.5) == 0.0
    floors.publish(map_message())
    assert distance(node, 3.95, 1.5) == 0.0
    floors.set(unknown_is_free=True)
    assert distance(node, 3.95, 1.5) > 0.0
    floors.set(floor=EDGE)
    assert distance(node, 2.5, 1.5) == 0.0
    for wrong, told in (
        ({"floor": "[[0, 0], [2, 2], [2, 0], [0, 2]]"}, "floor: given edges 0 and 2 that cross"),
        ({"floor": "a square"}, "floor: given 'a square', expected corners such as"),
        ({"clearance": -1.0}, "clearance"),
    ):
        kept, result = floors.floor, floors.set(**wrong)
        assert not result.successful and told in result.reason
        floors.graph.spin_for(0.1)
        assert floors.floor is kept


def test_map_file_is_read_when_it_is_set_or_refused(floors, tmp_path) -> None:
    file = map_file(tmp_path)
    floors.set(map_file=str(file))
    assert distance(floors.node, 1.5, 0.5) == 0.0
    map_file(tmp_path).with_suffix(".pgm").write_bytes(b"P5 20 10 255\n" + b"\xff" * 200)
    floors.set(map_file=str(file))
    assert distance(floors.node, 1.5, 0.5) > 0.0, "read again"
    cut = map_file(tmp_path, "cut")
    cut.with_suffix(".pgm").write_bytes(b"P5 20 10 255\n" + b"\xff" * 7)
    for wrong in (tmp_path / "none.yaml", cut):
        result = floors.set(map_file=str(wrong))
        assert not result.successful and result.reason.startswith(f"map file {wrong}: given ")
    # The file of a change that is refused as a whole is not used with the next one.
    assert not floors.set(map_file="", clearance=-1.0).successful
    assert floors.set(clearance=0.3).successful
    assert floors.floor.grid.occupied.shape == (10, 20), "the map is still there"
    floors.set(map_file="")
    assert floors.floor is None


@pytest.mark.parametrize(
    ("name", "given", "error"),
    [("map_file", "/none.yaml", InvalidMapError), ("floor", "[[0, 0], [1, 1]]",
                                                   InvalidParameterError)],
)
def test_floor_that_cannot_be_used_ends_the_start_with_one_line(
    floors, name, given, error
) -> None:
    with pytest.raises(error, match=f"{name.replace('_', ' ')}.*: given ") as caught:
        ControllerNode([Parameter(name, value=given)])
    assert "\n" not in str(caught.value) and caught.value.exit_code == 2
    # What was made of the node publishes for later tests until it is collected.
    del caught
    gc.collect()


def test_change_that_fails_late_is_not_kept(floors, capfd, monkeypatch) -> None:
    floors.publish(map_message())

    def fail(floor: Floor) -> Floor:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Floor, "prepared", fail)
        floors.areas.publish(area(1, SQUARE))
        floors.graph.until(lambda: "keepout not in force" in capfd.readouterr().err)
        result = floors.set(clearance=0.2)
        assert not result.successful and "is there room in /" in result.reason
    assert floors.node.get_parameter("clearance").value == 0.03 == floors.floor.clearance
    floors.publish(area(2, SQUARE, 1.0))
    assert distance(floors.node, 2.5, 1.5) == 0.0 < distance(floors.node, 1.5, 1.5)
    assert floors.set(clearance=0.1).successful and floors.floor.clearance == 0.1


class Gate:
    """Floors that are not made until it opens."""

    def __init__(self, monkeypatch: Any) -> None:
        opened, made = threading.Event(), Floor.prepared
        self.open = opened.set

        def prepared(floor: Floor) -> Floor:
            assert opened.wait(PATIENCE)
            return made(floor)

        monkeypatch.setattr(Floor, "prepared", prepared)


@pytest.fixture
def gate(floors, monkeypatch) -> Iterator[Gate]:
    """Return a gate that is open again before the floors of a test are removed."""
    gate = Gate(monkeypatch)
    yield gate
    gate.open()


def test_request_is_answered_when_its_floor_is_in_force_and_the_node_goes_on(
    gate, floors
) -> None:
    graph, statuses = floors.graph, floors.statuses
    answer = floors.asked(floor=EDGE, clearance=0.2)
    graph.until(lambda: float(values_of(statuses[-1])["floor_pending_s"]) > 0.0)
    seen = len(statuses)
    graph.until(lambda: len(statuses) > seen + 3)
    assert not answer.done() and floors.floor is None
    assert floors.node.get_parameter("floor").value == ""
    gate.open()
    graph.until(answer.done)
    assert [result.successful for result in answer.result().results] == [True, True]
    assert floors.floor.clearance == 0.2 and distance(floors.node, 2.5, 1.5) == 0.0
    assert floors.node.get_parameter("clearance").value == 0.2
    graph.until(lambda: float(values_of(statuses[-1])["floor_pending_s"]) == 0.0)


def test_request_that_is_refused_in_part_or_late_is_not_in_force(floors, tmp_path) -> None:
    graph = floors.graph
    answer = floors.asked(SetParametersAtomically, floor=EDGE, control_rate=-1.0)
    graph.until(answer.done)
    refused = answer.result().result
    assert not refused.successful and "control_rate" in refused.reason
    assert floors.floor is None and floors.node.get_parameter("floor").value == ""
    os.mkfifo(tmp_path / "pipe")
    answer = floors.asked(map_file=str(tmp_path / "pipe"), clearance=0.1, floor=7)
    graph.until(answer.done)
    file, clearance, other = answer.result().results
    assert not file.successful and "given a pipe, expected a regular file" in file.reason
    assert clearance.successful and not other.successful
    answer = floors.asked(SetParametersAtomically, floor=EDGE, clearance=0.3)
    graph.until(answer.done)
    assert answer.result().result.successful and floors.floor.clearance == 0.3
    assert distance(floors.node, 2.5, 1.5) == 0.0


def test_requests_that_overlap_are_each_answered(gate, floors) -> None:
    answers = [floors.asked(**values) for values in (
        {"floor": EDGE}, {"clearance": 0.2}, {"floor": "[[0, 0], [1, 1]]"}, {"clearance": 0.1},
    )]
    floors.areas.publish(area(1, SQUARE))
    floors.graph.spin_for(0.2)
    gate.open()
    floors.graph.until(lambda: all(answer.done() for answer in answers))
    given = [answer.result().results[0].successful for answer in answers]
    assert given == [True, True, False, True]
    floors.graph.until(lambda: distance(floors.node, 1.5, 1.5) == 0.0)
    assert floors.floor.clearance == floors.node.get_parameter("clearance").value
    assert distance(floors.node, 2.5, 1.5) == 0.0


def test_end_does_not_wait_for_a_floor_that_is_being_made(gate, floors) -> None:
    node = floors.graph.start(ControllerNode)
    floors.areas.publish(area(1, SQUARE))
    floors.graph.until(lambda: node._floor_receiver.pending > 0.0)
    floors.graph.remove(node)
    assert threads() and all(one.daemon for one in threads()), "neither does the interpreter"


def test_thread_has_no_part_in_the_priority_of_the_control_loop(floors, monkeypatch) -> None:
    given: list[tuple[int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, policy, wanted: given.append((pid, policy))
    )
    floors.publish(area(1, SQUARE))
    assert set(given) == {(0, os.SCHED_OTHER)}
