# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages that bring goals to a controller.

They have no frame, which means that of the controller, and a stamp of 0, which means now.
"""

from collections.abc import Sequence

from geometry_msgs.msg import Point, PointStamped, Pose, PoseStamped
from nav_msgs.msg import Goals, Path

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.messages import pose_to_ros

_HEIGHT = RobotParameters().shell_radius
"""Height of the goals [m], which controllers ignore."""


def pose_message(goal: Vector) -> PoseStamped:
    """Return the message of a goal, shape (6,)."""
    return pose_to_ros(goal, 0, _HEIGHT, frame="")


def point_message(position: Sequence[float] | Vector) -> PointStamped:
    """Return the message of a goal at a position [m] with any orientation."""
    return PointStamped(point=Point(x=float(position[0]), y=float(position[1]), z=_HEIGHT))


def path_message(places: Vector) -> Path:
    """Return the message of a path through places, shape (P, 2) [m]."""
    points = [Point(x=x, y=y, z=_HEIGHT) for x, y in places.tolist()]
    return Path(poses=[PoseStamped(pose=Pose(position=point)) for point in points])


def goals_message(goals: Sequence[Vector]) -> Goals:
    """Return the message of goals, each of shape (6,), to be visited in order."""
    return Goals(goals=[pose_message(goal) for goal in goals])
