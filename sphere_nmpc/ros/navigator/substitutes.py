# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Answers to what clients of Nav2 wait for and this navigator does not offer."""

from array import array
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from rclpy.service import Service

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.guarded_node import LATCHED, GuardedNode
from sphere_nmpc.ros.messages import message_object
from sphere_nmpc.ros.navigator.action_server import GoalServer

ACTIONS = {
    "assisted_teleop": "AssistedTeleop",
    "backup": "BackUp",
    "compute_and_track_route": "ComputeAndTrackRoute",
    "compute_path_through_poses": "ComputePathThroughPoses",
    "compute_path_to_pose": "ComputePathToPose",
    "compute_route": "ComputeRoute",
    "dock_robot": "DockRobot",
    "drive_on_heading": "DriveOnHeading",
    "follow_gps_waypoints": "FollowGPSWaypoints",
    "follow_object": "FollowObject",
    "smooth_path": "SmoothPath",
    "spin": "Spin",
    "undock_robot": "UndockRobot",
}
"""Actions of BasicNavigator, up to those of its newest version, that are not offered."""
SERVICES = {
    "collision_monitor/toggle": "Toggle",
    "global_costmap/clear_costmap_around_pose": "ClearCostmapAroundPose",
    "global_costmap/clear_entirely_global_costmap": "ClearEntireCostmap",
    "global_costmap/get_costmap": "GetCostmap",
    "local_costmap/clear_costmap_around_pose": "ClearCostmapAroundPose",
    "local_costmap/clear_costmap_around_robot": "ClearCostmapAroundRobot",
    "local_costmap/clear_costmap_except_region": "ClearCostmapExceptRegion",
    "local_costmap/clear_entirely_local_costmap": "ClearEntireCostmap",
    "local_costmap/get_costmap": "GetCostmap",
    "map_server/load_map": "LoadMap",
}
"""Services of BasicNavigator, of which those of type GetCostmap are offered."""
_LETHAL = 254
"""Cost of an occupied cell in nav2_costmap_2d."""


class Substitutes:
    """Servers that reject goals and refuse requests, so that nobody waits for an answer.

    There is one for each name of the tables whose type is installed, as long as no other node
    offers the same. Only costmaps are given: each is the floor of the controller, without cells
    where it has none.
    """

    def __init__(self, node: GuardedNode) -> None:
        self._node = node
        self._servers: dict[str, GoalServer | Service] = {}
        self._floor: bytes | None = None
        node.create_subscription(
            OccupancyGrid, "controller/floor", self._receive_floor, LATCHED, raw=True
        )

    def update(self) -> None:
        """Take the place of nodes that have gone, and give way to those that have come."""
        for kind, make, table, suffix in (
            ("action", self._action, ACTIONS, "/_action/send_goal"),
            ("srv", self._service, SERVICES, ""),
        ):
            installed = import_module(f"nav2_msgs.{kind}")
            for name, type_name in table.items():
                if not hasattr(installed, type_name):
                    continue
                own = self._servers.get(name)
                is_offered = self._node.count_services(
                    self._node.resolve_service_name(name + suffix)
                ) > (own is not None)
                if own is None and not is_offered:
                    self._servers[name] = make(getattr(installed, type_name), name)
                elif own is not None and is_offered:
                    self._destroy(self._servers.pop(name))

    def destroy(self) -> None:
        """Destroy the servers."""
        while self._servers:
            self._destroy(self._servers.popitem()[1])

    def _destroy(self, server: GoalServer | Service) -> None:
        if isinstance(server, Service):
            self._node.destroy_service(server)
        else:
            server.destroy()

    def _action(self, kind: Any, name: str) -> GoalServer:
        return GoalServer(self._node, kind, name, _refuse, _refuse, _refuse)

    def _service(self, kind: Any, name: str) -> Service:
        is_costmap = SERVICES[name] == "GetCostmap"
        answer: Callable[..., Any] = self._give_costmap if is_costmap else _refuse
        return self._node.create_service(kind, name, answer)

    def _receive_floor(self, message: bytes) -> None:
        self._floor = message

    def _give_costmap(self, _: Any, response: Any) -> Any:
        if self._floor is not None:
            floor = message_object(self._floor, OccupancyGrid)
            costmap, about = response.map, response.map.metadata
            costmap.header, about.map_load_time = floor.header, floor.info.map_load_time
            about.update_time, about.layer = floor.header.stamp, "controller/floor"
            about.resolution, about.origin = floor.info.resolution, floor.info.origin
            about.size_x, about.size_y = floor.info.width, floor.info.height
            costs = np.where(np.asarray(floor.data) > 0, _LETHAL, 0).astype(np.uint8)
            costmap.data = array("B", costs.tobytes())
        return response


def _refuse(*_: object) -> Any:
    raise SphereNmpcError("not offered by this navigator")
