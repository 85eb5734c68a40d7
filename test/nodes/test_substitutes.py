# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What clients of Nav2 ask for beside goals is answered, by this navigator or by another node."""

from pathlib import Path
from typing import Any

import navigation_messages
import pytest
from nav_msgs.msg import OccupancyGrid
from rclpy.action import ActionClient, ActionServer
from rclpy.action.server import ServerGoalHandle
from ros_graph import Graph

from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.navigator.node import NavigatorNode
from sphere_nmpc.ros.navigator.substitutes import ACTIONS, SERVICES

DOCUMENT = Path(__file__).parents[2] / "msg_docs" / "topics.md"
ACTION, SERVICE = "spin", "map_server/load_map"


@pytest.fixture
def navigator(graph: Graph) -> NavigatorNode:
    navigation_messages.provide()
    return graph.start(NavigatorNode)


def goal_is_accepted(graph: Graph, name: str) -> bool:
    """Return the answer to a goal of an action whose server is waited for."""
    from nav2_msgs import action

    kind = getattr(action, ACTIONS[name])
    client = ActionClient(graph.probe, kind, name)
    graph.until(client.server_is_ready)
    answer = client.send_goal_async(kind.Goal())
    graph.until(answer.done)
    client.destroy()
    return bool(answer.result().accepted)


def answer_of(graph: Graph, name: str, **fields: Any) -> Any:
    from nav2_msgs import srv

    kind = getattr(srv, SERVICES[name])
    return graph.call(kind, name, **fields)


@pytest.mark.slow
def test_each_name_whose_type_is_installed_is_answered(graph, navigator) -> None:
    from nav2_msgs import action, srv

    log = navigator._fault_log
    for name in (name for name, kind in ACTIONS.items() if hasattr(action, kind)):
        assert not goal_is_accepted(graph, name)
        assert log.counts[f"{name} rejected"] == 1
    for name in (name for name, kind in SERVICES.items() if hasattr(srv, kind)):
        assert answer_of(graph, name) is not None
        assert (f"{name} refused" in log.counts) is not name.endswith("/get_costmap")
    assert answer_of(graph, SERVICE, map_url="room.yaml").result == 255


@pytest.mark.slow
def test_costmap_is_the_floor_of_the_controller(graph, navigator) -> None:
    assert len(answer_of(graph, "global_costmap/get_costmap").map.data) == 0
    floor = OccupancyGrid(data=[0, 100, 0, 100, 0, 0])
    floor.header.frame_id = "map"
    floor.info.width, floor.info.height, floor.info.resolution = 3, 2, 0.25
    floor.info.origin.position.x = -1.0
    graph.probe.create_publisher(OccupancyGrid, "controller/floor", LATCHED).publish(floor)
    for name in ("global_costmap/get_costmap", "local_costmap/get_costmap"):
        graph.until(lambda name=name: answer_of(graph, name).map.metadata.size_x)
        costmap = answer_of(graph, name).map
        assert costmap.header == floor.header
        about = costmap.metadata
        assert (about.size_x, about.size_y, about.resolution) == (3, 2, 0.25)
        assert about.origin == floor.info.origin
        assert list(costmap.data) == [0, 254, 0, 254, 0, 0]


@pytest.mark.slow
def test_other_nodes_that_offer_the_same_are_given_way(graph, navigator) -> None:
    from nav2_msgs.action import Spin
    from nav2_msgs.srv import LoadMap

    def execute(handle: ServerGoalHandle) -> Any:
        handle.succeed()
        return Spin.Result()

    def load(_: Any, response: Any) -> Any:
        response.result = LoadMap.Response.RESULT_SUCCESS
        return response

    def servers() -> tuple[int, int]:
        count = graph.probe.count_services
        return count(f"/{ACTION}/_action/send_goal"), count(f"/{SERVICE}")

    graph.until(lambda: servers() == (1, 1))
    action = ActionServer(graph.probe, Spin, ACTION, execute)
    service = graph.probe.create_service(LoadMap, SERVICE, load)
    graph.until(lambda: not {ACTION, SERVICE} & navigator._substitutes._servers.keys())
    assert goal_is_accepted(graph, ACTION)
    assert answer_of(graph, SERVICE).result == LoadMap.Response.RESULT_SUCCESS
    action.destroy()
    graph.probe.destroy_service(service)
    graph.until(lambda: {ACTION, SERVICE} <= navigator._substitutes._servers.keys())
    assert not goal_is_accepted(graph, ACTION)


def test_document_lists_each_name() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    assert [name for name in (*ACTIONS, *SERVICES) if f"`{name}`" not in text] == []
