# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The floor of the controller node over real DDS: maps, areas to keep out of, and parameters."""

import array
import math
import os
import re
import threading
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
from ros_graph import values_of

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import InvalidMapError
from sphere_nmpc.ros import floor_receiver
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.guarded_node import LATCHED

pytestmark = pytest.mark.slow

KEPT = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SQUARE = [(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)]


@pytest.fixture(autouse=True)
def _own_goal_files(monkeypatch, tmp_path) -> None:
    """Keep stored goals apart from those of other tests."""
    monkeypatch.setattr(
        "sphere_nmpc.ros.controller.stored_goal.goal_file",
        lambda node: tmp_path / node.get_name(),
    )


def map_message(**changes: Any) -> OccupancyGrid:
    """Return a map of 4 m x 3 m whose first column is occupied and whose last one is unknown."""
    values = np.zeros((30, 40), dtype=np.int8)
    values[:, 0], values[:, -1] = 100, -1
    message = OccupancyGrid()
    message.header.frame_id = "world"
    message.info.height, message.info.width = values.shape
    message.info.resolution = 0.1
    message.info.origin.orientation.w = 1.0
    message.data = array.array("b", values.tobytes())
    for name, value in changes.items():
        *path, last = name.split("__")
        part: Any = message
        for word in path:
            part = getattr(part, word)
        setattr(part, last, value)
    return message


def polygon_message(number: int, corners: list, frame: str = "") -> PolygonInstanceStamped:
    message = PolygonInstanceStamped()
    message.header.frame_id = frame
    message.polygon.id = number
    message.polygon.polygon.points = [Point32(x=x, y=y) for x, y in corners]
    return message


def map_file(folder: Path, name: str = "hall") -> Path:
    """Write a map file of 2 m x 1 m whose left half is free."""
    rows = b"\xff" * 10 + b"\x00" * 10
    (folder / f"{name}.pgm").write_bytes(b"P5 20 10 255\n" + rows * 10)
    file = folder / f"{name}.yaml"
    file.write_text(f"image: {name}.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n")
    return file


class Floors:
    """A controller node, its floor, and publishers of what it is made of."""

    def __init__(self, graph: Any, **settings: Any) -> None:
        self.graph = graph
        self.node = ControllerNode([Parameter(k, value=v) for k, v in settings.items()])
        graph.add(self.node)
        self.shown: list[OccupancyGrid] = graph.collect(
            OccupancyGrid, "controller/floor", LATCHED
        )
        self.maps = graph.probe.create_publisher(OccupancyGrid, "map", LATCHED)
        self.keepouts = graph.probe.create_publisher(PolygonInstanceStamped, "keepout", KEPT)
        for publisher in (self.maps, self.keepouts):
            graph.until(lambda publisher=publisher: publisher.get_subscription_count() > 0)

    @property
    def floor(self) -> Any:
        floor = self.node.controller.floor
        return None if floor.is_empty else floor

    def changes(self, change: Any) -> Any:
        """Return the floor after a change that leads to a new one."""
        before = self.floor
        change()
        self.graph.until(lambda: self.floor is not before)
        return self.floor

    def distance(self, x: float, y: float) -> float:
        return float(self.floor.distances(np.array([[x, y]]))[0])

    def set(self, **values: Any) -> Any:
        """Return the answer to a change of parameters."""
        changes = [Parameter(name, value=value) for name, value in values.items()]
        return self.node.set_parameters_atomically(changes)

    def refused(self, kind: str) -> int:
        return self.node._fault_log.counts[f"{kind} refused"]


def test_without_a_map_there_is_no_floor_and_none_is_shown(graph) -> None:
    floors = Floors(graph)
    graph.spin_for(0.3)
    assert floors.floor is None and not floors.shown
    assert not [one for one in threading.enumerate() if one.name.startswith("floor")]


def test_map_is_taken_and_shown(graph, capfd) -> None:
    floors = Floors(graph)
    given = map_message(
        info__origin__position__x=-1.0, info__origin__orientation__z=math.sqrt(0.5),
        info__origin__orientation__w=math.sqrt(0.5),
    )
    floor = floors.changes(lambda: floors.maps.publish(given))
    assert floor.radius == 0.3 and floor.clearance == 0.03
    assert "corner_distances" in vars(floor), "nothing is left for the control loop to compute"
    # The grid's x axis is the world's y axis: from y = 0.1 to 3.9 it is free, and to x = -4.
    assert floors.distance(-2.0, 1.1) == pytest.approx(1.0, abs=0.05)
    assert floors.distance(-2.0, 3.8) == pytest.approx(0.1, abs=0.05)
    assert floors.distance(-0.9, 2.0) == 0.0
    graph.until(lambda: floors.shown)
    (shown,) = floors.shown
    assert shown.header.frame_id == "world" and shown.info.origin.position.x == -1.0
    assert shown.info.origin.orientation.z == pytest.approx(math.sqrt(0.5))
    assert shown.info.resolution == pytest.approx(0.1, rel=1e-6)
    values = np.array(shown.data).reshape(shown.info.height, shown.info.width)
    expected = np.zeros((30, 40))
    expected[:, 0] = expected[:, -1] = 100
    np.testing.assert_array_equal(values, expected)
    log = capfd.readouterr().err
    line = r"floor: 40 x 30 cells of 0.1 m, 4 m x 3 m, 95 % free, in force after \d+\.\d\d s"
    assert len(re.findall(line, log)) == 1


def test_late_starter_takes_the_map_and_areas_that_were_published_before(graph) -> None:
    maps = graph.probe.create_publisher(OccupancyGrid, "map", LATCHED)
    keepouts = graph.probe.create_publisher(PolygonInstanceStamped, "keepout", KEPT)
    maps.publish(map_message())
    for number in range(3):
        keepouts.publish(polygon_message(number, [(x + number, y) for x, y in SQUARE], "world"))
    node = ControllerNode()
    graph.add(node)
    places = np.array([[1.5, 1.5], [2.5, 1.5], [3.5, 1.5]])
    graph.until(lambda: not node.controller.floor.distances(places).any())
    assert node.controller.floor.distances(np.array([[0.5, 0.5]]))[0] > 0.0


def test_areas_to_keep_out_of_are_added_replaced_and_removed(graph) -> None:
    floors = Floors(graph)
    floors.changes(lambda: floors.keepouts.publish(polygon_message(7, SQUARE)))
    assert floors.distance(1.5, 1.5) == 0.0
    assert floors.distance(0.0, 1.5) == pytest.approx(1.0, abs=0.05)
    moved = [(x, y + 2.0) for x, y in SQUARE]
    floors.changes(lambda: floors.keepouts.publish(polygon_message(7, moved)))
    assert floors.distance(1.5, 1.5) > 1.0 and floors.distance(1.5, 3.5) == 0.0
    kept = floors.changes(lambda: floors.keepouts.publish(polygon_message(8, SQUARE)))
    floors.keepouts.publish(polygon_message(8, SQUARE, "world"))
    floors.keepouts.publish(polygon_message(99, []))
    graph.spin_for(0.5)
    assert floors.floor is kept, "what changes nothing leaves the floor as it is"
    floors.changes(lambda: floors.keepouts.publish(polygon_message(7, [])))
    assert floors.distance(1.5, 3.5) > 0.0 and floors.distance(1.5, 1.5) == 0.0
    assert floors.changes(lambda: floors.keepouts.publish(polygon_message(8, []))) is None
    graph.until(lambda: floors.shown[-1].info.width == 0)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"info__width": 41}, "given '1200 values', expected width x height, 1230"),
        ({"info__width": 0}, "given '0 x 30 cells', expected 1 to 100000000 cells"),
        ({"info__width": 20_000, "info__height": 20_000}, "given '20000 x 20000 cells', expected"),
        ({"info__resolution": 0.0}, "given 'a resolution of 0 m', expected a positive number"),
        ({"info__resolution": math.nan}, "given 'a resolution of nan m', expected a positive"),
        ({"data": array.array("b", [101] * 1200)}, "given 'a value of 101', expected -1 (unkn"),
        ({"data": array.array("b", [-2] * 1200)}, "given 'a value of -2', expected -1 (unknown)"),
        ({"header__frame_id": "odom"}, "given 'frame odom', expected 'world' (world_frame) or no"),
        ({"info__origin__orientation__x": 0.1}, "given 'an origin with roll or pitch', expected"),
        ({"info__origin__position__y": math.nan}, "given 'the origin [0.0, nan, "),
    ],
)
def test_bad_map_is_refused_with_one_line_and_the_floor_stays(
    graph, capfd, changes, told
) -> None:
    floors = Floors(graph)
    floor = floors.changes(lambda: floors.maps.publish(map_message()))
    floors.maps.publish(map_message(**changes))
    graph.until(lambda: floors.refused("map") == 1)
    lines = [line for line in capfd.readouterr().err.splitlines() if "map refused" in line]
    assert len(lines) == 1 and f"map refused: map: {told}" in lines[0]
    assert lines[0].endswith("; the floor in force stays")
    assert floors.floor is floor
    floors.changes(lambda: floors.maps.publish(map_message(info__resolution=0.2)))


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (polygon_message(3, [(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]),
         "keepout 3: given 'edges 0 and 2 that cross', expected a simple polygon"),
        (polygon_message(3, [(0.0, 0.0), (1.0, math.nan), (1.0, 0.0)]),
         "keepout 3: given '3 corners', expected three or more, finite, within 1e+06 m"),
        (polygon_message(3, SQUARE[:2]), "keepout 3: given '2 corners', expected three or more"),
        (polygon_message(3, [(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)]),
         "keepout 3: given 'an area of 0', expected a polygon with an area"),
        (polygon_message(3, SQUARE, "odom"), "keepout: given 'frame odom', expected 'world'"),
    ],
)
def test_bad_area_is_refused_alone(graph, capfd, message, told) -> None:
    floors = Floors(graph)
    floors.changes(lambda: floors.keepouts.publish(polygon_message(3, SQUARE)))
    floors.keepouts.publish(message)
    graph.until(lambda: floors.refused("keepout") == 1)
    assert floors.distance(1.5, 1.5) == 0.0
    lines = [line for line in capfd.readouterr().err.splitlines() if "keepout refused" in line]
    assert len(lines) == 1 and told in lines[0]


def test_parameters_of_the_floor_are_live(graph) -> None:
    floors = Floors(graph, occupied_threshold=0.65, clearance=0.1)
    half = map_message(data=array.array("b", [50] * 1200))
    floors.changes(lambda: floors.maps.publish(half))
    assert floors.floor.clearance == 0.1 and floors.distance(2.0, 1.5) > 1.0
    assert floors.changes(lambda: floors.set(clearance=0.3)).clearance == 0.3
    floors.changes(lambda: floors.set(occupied_threshold=0.5))
    assert floors.distance(2.0, 1.5) == 0.0
    floors.changes(lambda: floors.maps.publish(map_message()))
    assert floors.distance(3.95, 1.5) == 0.0
    floors.changes(lambda: floors.set(unknown_is_free=True))
    assert floors.distance(3.95, 1.5) > 0.0
    floors.changes(lambda: floors.set(floor="[[0, 0], [2, 0], [2, 3], [0, 3]]"))
    assert floors.distance(2.5, 1.5) == 0.0
    for wrong, told in (
        ({"floor": "[[0, 0], [2, 2], [2, 0], [0, 2]]"}, "floor: given 'edges 0 and 2 that cross'"),
        ({"floor": "a square"}, "floor: given 'a square', expected corners such as"),
        ({"clearance": -1.0}, "clearance"),
    ):
        kept, result = floors.floor, floors.set(**wrong)
        assert not result.successful and told in result.reason
        graph.spin_for(0.1)
        assert floors.floor is kept


def test_map_file_is_used_from_the_start_until_a_map_is_received(graph, tmp_path) -> None:
    floors = Floors(graph, map_file=str(map_file(tmp_path)))
    assert floors.floor is not None, "before anything can be received"
    assert floors.distance(0.5, 0.5) > 0.4 and floors.distance(1.5, 0.5) == 0.0
    graph.until(lambda: floors.shown)
    floors.changes(lambda: floors.maps.publish(map_message()))
    assert floors.distance(1.5, 1.5) > 1.0


def test_map_file_is_read_when_it_is_set_or_refused(graph, tmp_path) -> None:
    floors = Floors(graph)
    file = map_file(tmp_path)
    floors.changes(lambda: floors.set(map_file=str(file)))
    assert floors.distance(1.5, 0.5) == 0.0
    map_file(tmp_path).with_suffix(".pgm").write_bytes(b"P5 20 10 255\n" + b"\xff" * 200)
    floors.changes(lambda: floors.set(map_file=str(file)))
    assert floors.distance(1.5, 0.5) > 0.0, "read again"
    kept = floors.floor
    (tmp_path / "cut.pgm").write_bytes(b"P5 20 10 255\n" + b"\xff" * 7)
    cut = tmp_path / "cut.yaml"
    cut.write_text("image: cut.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n")
    for wrong in (tmp_path / "none.yaml", cut):
        result = floors.set(map_file=str(wrong))
        assert not result.successful and result.reason.startswith(f"map file {wrong}: given ")
    # The file of a change that is refused as a whole is not used with the next one.
    assert not floors.set(map_file="", clearance=-1.0).successful
    kept = floors.changes(lambda: floors.set(clearance=0.3))
    assert kept is not None and kept.grid.occupied.shape == (10, 20), "the map is still there"
    assert floors.changes(lambda: floors.set(map_file="")) is None


def test_map_file_that_cannot_be_read_ends_the_start_with_one_line(graph, tmp_path) -> None:
    with pytest.raises(InvalidMapError, match=r"map file .*none\.yaml: given ") as caught:
        ControllerNode([Parameter("map_file", value=str(tmp_path / "none.yaml"))])
    assert "\n" not in str(caught.value) and caught.value.exit_code == 2
    with pytest.raises(InvalidParameterError, match="floor: given "):
        ControllerNode([Parameter("floor", value="[[0, 0], [1, 1]]")])


def test_floor_that_cannot_be_made_leaves_the_one_in_force(graph, capfd, monkeypatch) -> None:
    floors = Floors(graph)
    floor = floors.changes(lambda: floors.maps.publish(map_message()))

    def fail(self: Any) -> Any:
        raise MemoryError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(floor_receiver.Layers, "grid", fail)
        floors.maps.publish(map_message(info__resolution=0.2))
        graph.until(lambda: "floor refused" in capfd.readouterr().err)
    graph.unforeseen.clear()
    assert floors.floor is floor
    floors.changes(lambda: floors.maps.publish(map_message(info__resolution=0.3)))


@pytest.mark.parametrize("kind", ["map", "keepout"])
def test_change_that_fails_late_is_not_kept(graph, capfd, monkeypatch, kind) -> None:
    floors = Floors(graph)
    floors.changes(lambda: floors.maps.publish(map_message()))

    def fail(floor: Floor) -> Floor:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Floor, "prepared", fail)
        if kind == "map":
            floors.maps.publish(map_message(info__resolution=0.2))
        else:
            floors.keepouts.publish(polygon_message(1, SQUARE))
        graph.until(lambda: f"{kind} not in force" in capfd.readouterr().err)
        result = floors.set(clearance=0.2)
        assert not result.successful and "is there room in /" in result.reason
    graph.unforeseen.clear()
    assert floors.node.get_parameter("clearance").value == 0.03 == floors.floor.clearance
    area = [(x + 1.0, y) for x, y in SQUARE]
    floors.changes(lambda: floors.keepouts.publish(polygon_message(2, area)))
    assert floors.distance(2.5, 1.5) == 0.0 and floors.distance(1.5, 1.5) > 0.0
    grid = floors.floor.grid
    assert grid.resolution * grid.occupied.shape[1] == pytest.approx(4.0), "the first map"
    assert floors.set(clearance=0.1).successful and floors.floor.clearance == 0.1
    assert floors.set(floor="[[0, 0], [2, 0], [2, 3], [0, 3]]").successful
    assert floors.distance(2.2, 0.5) == 0.0


@pytest.mark.parametrize(
    "bad", [{"info__origin__position__x": 2e6}, {"info__resolution": 1e-30}], ids=str
)
def test_map_that_cannot_be_shown_is_refused_before_it_is_made(graph, bad) -> None:
    floors = Floors(graph)
    floors.maps.publish(map_message(**bad))
    graph.until(lambda: floors.refused("map") == 1)
    floors.changes(lambda: floors.keepouts.publish(polygon_message(1, SQUARE)))
    assert floors.distance(1.5, 1.5) == 0.0


def test_area_far_away_is_refused_and_does_not_spoil_a_near_one(graph, capfd) -> None:
    floors = Floors(graph)
    floor = floors.changes(lambda: floors.keepouts.publish(polygon_message(1, SQUARE)))
    floors.keepouts.publish(polygon_message(2, [(x + 1e5, y + 1e5) for x, y in SQUARE]))
    graph.until(lambda: floors.refused("keepout") == 1)
    assert "keepout refused: keepout 2: given 'a floor of 1.0" in capfd.readouterr().err
    assert floors.floor is floor and floors.distance(0.5, 1.5) > 0.4
    floors.changes(lambda: floors.maps.publish(map_message()))
    kept = floors.floor
    floors.keepouts.publish(polygon_message(2, [(x + 1e5, y + 1e5) for x, y in SQUARE]))
    floors.changes(lambda: floors.keepouts.publish(polygon_message(1, [])))
    assert floors.distance(1.5, 1.5) > 1.0 and floors.floor is not kept
    assert floors.refused("keepout") == 1, "beside the map it has no effect"


def test_area_of_too_many_corners_is_refused_before_it_is_read(graph, capfd) -> None:
    floors = Floors(graph)
    floors.keepouts.publish(polygon_message(1, [(0.0, 0.0)] * 20_000))
    graph.until(lambda: floors.refused("keepout") == 1)
    told = "keepout refused: keepout: given '240036 bytes', expected at most 5000 corners"
    assert told in capfd.readouterr().err
    floors.changes(lambda: floors.keepouts.publish(polygon_message(1, SQUARE)))


class Gate:
    """Floors that are not made until it opens."""

    def __init__(self, monkeypatch: Any) -> None:
        self._open = threading.Event()
        made = Floor.prepared

        def prepared(floor: Floor) -> Floor:
            assert self._open.wait(PATIENCE)
            return made(floor)

        monkeypatch.setattr(Floor, "prepared", prepared)

    def open(self) -> None:
        self._open.set()


def asked(graph: Any, atomically: bool = False, **values: Any) -> Any:
    """Return the future of the answer to a request to change parameters."""
    kind, name = SetParameters, "set_parameters"
    if atomically:
        kind, name = SetParametersAtomically, "set_parameters_atomically"
    client = graph.probe.create_client(kind, f"controller/{name}")
    graph.until(client.service_is_ready)
    parameters = [Parameter(key, value=value).to_parameter_msg() for key, value in values.items()]
    return client.call_async(kind.Request(parameters=parameters))


def test_request_is_answered_when_its_floor_is_in_force_and_the_node_goes_on(
    graph, monkeypatch
) -> None:
    floors = Floors(graph)
    statuses = graph.collect(DiagnosticStatus, "controller/status")
    gate = Gate(monkeypatch)
    answer = asked(graph, floor="[[0, 0], [2, 0], [2, 3], [0, 3]]", clearance=0.2)
    graph.until(lambda: statuses and float(values_of(statuses[-1])["floor_pending_s"]) > 0.0)
    seen = len(statuses)
    graph.until(lambda: len(statuses) > seen + 3)
    assert not answer.done() and floors.floor is None
    assert floors.node.get_parameter("floor").value == ""
    gate.open()
    graph.until(answer.done)
    assert [result.successful for result in answer.result().results] == [True, True]
    assert floors.floor.clearance == 0.2 and floors.distance(2.5, 1.5) == 0.0
    assert floors.node.get_parameter("clearance").value == 0.2
    seen = len(statuses)
    graph.until(lambda: float(values_of(statuses[-1])["floor_pending_s"]) == 0.0)


def test_request_that_is_refused_in_part_or_late_is_not_in_force(graph, tmp_path) -> None:
    floors = Floors(graph)
    edge = "[[0, 0], [2, 0], [2, 3], [0, 3]]"
    answer = asked(graph, atomically=True, floor=edge, control_rate=-1.0)
    graph.until(answer.done)
    refused = answer.result().result
    assert not refused.successful and "control_rate" in refused.reason
    assert floors.floor is None and floors.node.get_parameter("floor").value == ""
    os.mkfifo(tmp_path / "pipe")
    answer = asked(graph, map_file=str(tmp_path / "pipe"), clearance=0.1, floor=7)
    graph.until(answer.done)
    file, clearance, other = answer.result().results
    assert not file.successful and "given 'a pipe', expected a regular file" in file.reason
    assert clearance.successful and not other.successful
    answer = asked(graph, atomically=True, floor=edge, clearance=0.3)
    graph.until(answer.done)
    assert answer.result().result.successful and floors.floor.clearance == 0.3
    assert floors.distance(2.5, 1.5) == 0.0


def test_requests_that_overlap_are_each_answered(graph, monkeypatch) -> None:
    floors = Floors(graph)
    gate = Gate(monkeypatch)
    answers = [
        asked(graph, floor="[[0, 0], [2, 0], [2, 3], [0, 3]]"), asked(graph, clearance=0.2),
        asked(graph, floor="[[0, 0], [1, 1]]"), asked(graph, clearance=0.1),
    ]
    floors.keepouts.publish(polygon_message(1, SQUARE))
    graph.spin_for(0.2)
    gate.open()
    graph.until(lambda: all(answer.done() for answer in answers))
    given = [answer.result().results[0].successful for answer in answers]
    assert given == [True, True, False, True]
    graph.until(lambda: floors.distance(1.5, 1.5) == 0.0)
    assert floors.floor.clearance == floors.node.get_parameter("clearance").value
    assert floors.distance(2.5, 1.5) == 0.0


def test_end_does_not_wait_for_a_floor_that_is_being_made(graph, monkeypatch) -> None:
    floors = Floors(graph)
    gate = Gate(monkeypatch)
    floors.maps.publish(map_message())
    graph.until(lambda: floors.node._floor_receiver.pending > 0.0)
    graph.remove(floors.node)
    (thread,) = (one for one in threading.enumerate() if one.name == "floor")
    assert thread.daemon, "neither does the interpreter"
    gate.open()
    thread.join(PATIENCE)


def test_thread_has_no_part_in_the_priority_of_the_control_loop(graph, monkeypatch) -> None:
    given: list[tuple[int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, policy, wanted: given.append((pid, policy))
    )
    floors = Floors(graph)
    floors.changes(lambda: floors.maps.publish(map_message()))
    assert given == [(0, os.SCHED_OTHER)]
