# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Marker node: shell with circle Gamma, goal, plan and path for RViz.

subscribes  pose, controller/active_goal, controller/predicted_path
publishes   markers
"""

from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import Path
from rclpy.parameter import Parameter
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.guarded_node import LATCHED, NEWEST
from sphere_nmpc.ros.lifetime import RunnableNode, run
from sphere_nmpc.ros.messages import pose_from_ros
from sphere_nmpc.ros.settings import FrameSettings
from sphere_sim.viewer import colours
from sphere_sim.viewer.colours import Colour
from sphere_sim.viewer.frame import radius_at
from sphere_sim.viewer.geometry import great_circle

_PERIOD = 0.1
"""Wall time between two messages [s]."""
_PATH_POINTS = 2000
"""Most points of the path."""
_SPACING = 1.0 / 15.0
"""Least distance of two points of the path over the radius."""


class MarkerNode(RunnableNode):
    """Node that publishes markers while they have a subscriber.

    Parameters
    ----------
    parameter_overrides : list of Parameter, optional
        Parameters as given on a command line; for use within a program.
    """

    def __init__(self, parameter_overrides: list[Parameter] | None = None) -> None:
        super().__init__("markers", parameter_overrides)
        self._frame = self.parameters.declare(FrameSettings()).settings.world_frame
        self.parameters.warn_of_unknown()
        self._pose: PoseStamped | None = None
        self._goal: PoseStamped | None = None
        self._plan = Path()
        self._path: deque[tuple[float, float]] = deque(maxlen=_PATH_POINTS)
        self.create_subscription(PoseStamped, "pose", self._take_pose, NEWEST)
        self.create_subscription(PoseStamped, "controller/active_goal", self._take_goal, LATCHED)
        self.create_subscription(Path, "controller/predicted_path", self._take_plan, NEWEST)
        self._markers = self.create_publisher(MarkerArray, "markers", 1)
        self.create_wall_timer(_PERIOD, self._publish)

    def _take_pose(self, message: PoseStamped) -> None:
        if not _is_valid(message):
            return
        self._pose = message
        place = (message.pose.position.x, message.pose.position.y)
        spacing = _SPACING * radius_at(message.pose.position.z)
        if not self._path or np.hypot(*np.subtract(place, self._path[-1])) > spacing:
            self._path.append(place)

    def _take_goal(self, message: PoseStamped) -> None:
        if _is_valid(message):
            self._goal = message

    def _take_plan(self, message: Path) -> None:
        self._plan = message

    def _publish(self) -> None:
        if self._pose is None or self._markers.get_subscription_count() == 0:
            return
        radius = radius_at(self._pose.pose.position.z)
        markers = [
            _shell("sphere", self._pose, radius, colours.BLUE, 0.3),
            _line("gamma", great_circle(1.005 * radius), 0.02 * radius, colours.GAMMA),
            _line("path", ((*place, 0.01 * radius) for place in self._path), 0.04 * radius,
                  colours.PATH),
            _line("plan", ((p.pose.position.x, p.pose.position.y, 0.02 * radius)
                           for p in self._plan.poses), radius / 15.0, colours.PLAN),
        ]
        # Gamma is given in the body frame, so its marker has the pose of the sphere.
        markers[1].pose = self._pose.pose
        if self._goal is not None:
            markers.append(_shell("goal", self._goal, radius, colours.GOAL, 0.3))
        for marker in markers:
            # With stamp 0 RViz uses the newest transform, and never waits for one of that time.
            marker.header.frame_id, marker.header.stamp = self._frame, Time()
        self._markers.publish(MarkerArray(markers=markers))


def _is_valid(message: PoseStamped) -> bool:
    try:
        pose_from_ros(message)
    except InvalidStateError:
        return False
    return True


def _marker(name: str, kind: int, colour: Colour, alpha: float) -> Marker:
    marker = Marker(ns=name, type=kind, action=Marker.ADD)
    red, green, blue = (part / 255.0 for part in colour)
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    marker.pose.orientation.w = 1.0
    return marker


def _shell(name: str, at: PoseStamped, radius: float, colour: Colour, alpha: float) -> Marker:
    marker = _marker(name, Marker.SPHERE, colour, alpha)
    marker.pose = at.pose
    marker.scale.x = marker.scale.y = marker.scale.z = 2.0 * radius
    return marker


def _line(
    name: str, points: Iterable[Sequence[float]] | Vector, width: float, colour: Colour
) -> Marker:
    marker = _marker(name, Marker.LINE_STRIP, colour, 1.0)
    marker.scale.x = width
    marker.points = [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in points]
    if len(marker.points) < 2:
        # RViz reports lines without two points as errors.
        marker.action, marker.points = Marker.DELETE, []
    return marker


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see `sphere_nmpc.ros.lifetime.run`."""
    return run(MarkerNode, args, __doc__ or "")
