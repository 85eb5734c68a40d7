# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Marker node: shell with circle Gamma, goal, plan and path for RViz.

subscribes  pose, ground_truth/pose, controller/active_goal, controller/predicted_path
publishes   markers
"""

from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from rclpy.parameter import Parameter
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.lifetime import run
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_nmpc.ros.settings import FrameSettings
from sphere_sim.output import colours
from sphere_sim.output.colours import Colour
from sphere_sim.ros.viewer.robot_subscriptions import RobotSubscriptions
from sphere_sim.viewer.geometry import great_circle

_PERIOD = 0.1
"""Wall time between two messages [s]."""
_PATH_POINTS = 2000
"""Most points of the path."""
_SPACING = 1.0 / 15.0
"""Least distance of two points of the path over the radius."""


class MarkerNode(GuardedNode):
    """Node that publishes markers while they have a subscriber."""

    def __init__(self, parameter_overrides: list[Parameter] | None = None) -> None:
        super().__init__("markers", parameter_overrides)
        self._frame = self.parameters.declare(FrameSettings()).settings.world_frame
        self.parameters.warn_of_unknown()
        self._robot = RobotSubscriptions(self, self._frame, True, self._extend_path)
        self._path: deque[Vector] = deque(maxlen=_PATH_POINTS)
        self._markers = self.create_publisher(MarkerArray, "markers", 1)
        self.create_wall_timer(_PERIOD, self._publish)

    def _extend_path(self) -> None:
        frame = self._robot.newest()
        if frame.state is None:
            return
        if frame.restarted:
            self._path.clear()
        place = frame.state[POSITION]
        if not self._path or np.hypot(*(place - self._path[-1])) > _SPACING * frame.radius:
            self._path.append(place)

    def _publish(self) -> None:
        frame = self._robot.newest()
        if frame.state is None or self._markers.get_subscription_count() == 0:
            return
        radius = frame.radius
        markers = [
            _shell("sphere", frame.state, radius, colours.BLUE, 0.3),
            _line("gamma", great_circle(1.005 * radius), 0.02 * radius, colours.GAMMA),
            _line("path", ((*xy, 0.01 * radius) for xy in self._path), 0.04 * radius,
                  colours.PATH),
            _line("plan", ((*xy, 0.02 * radius) for xy in frame.plan[:, POSITION]), radius / 15.0,
                  colours.PLAN),
        ]
        # Gamma is given in the body frame, so its marker has the pose of the sphere.
        markers[1].pose = markers[0].pose
        if frame.goal is not None:
            markers.append(_shell("goal", frame.goal.pose, radius, colours.GOAL, 0.3))
        if frame.estimate is not None:
            markers.append(_shell("estimate", frame.estimate, radius, colours.ESTIMATE, 0.3))
        for marker in markers:
            # With stamp 0 RViz uses the newest transform, and never waits for one of that time.
            marker.header.frame_id, marker.header.stamp = self._frame, Time()
        self._markers.publish(MarkerArray(markers=markers))


def _marker(name: str, kind: int, colour: Colour, alpha: float) -> Marker:
    marker = Marker(ns=name, type=kind, action=Marker.ADD)
    red, green, blue = (part / 255.0 for part in colour)
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    marker.pose.orientation.w = 1.0
    return marker


def _shell(name: str, state: Vector, radius: float, colour: Colour, alpha: float) -> Marker:
    marker = _marker(name, Marker.SPHERE, colour, alpha)
    marker.pose = pose_to_ros(state, 0, radius).pose
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
