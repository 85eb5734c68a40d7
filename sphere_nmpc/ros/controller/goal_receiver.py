# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals by topic: a pose, a point, several poses to be visited in order, or a path to follow."""

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Goals
from nav_msgs.msg import Path as PathMessage

from sphere_nmpc.control.active_course import ActiveCourse
from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.path import Path
from sphere_nmpc.model.state import upright_state
from sphere_nmpc.reporting.fault_log import FaultLog
from sphere_nmpc.ros.control_clock import ControlClock
from sphere_nmpc.ros.graph_monitor import NO_EVENTS
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.messages import (
    MOST_GOALS,
    MOST_PLACES,
    framed_places_from_ros,
    framed_point_from_ros,
    framed_pose_from_ros,
    framed_poses_from_ros,
    pose_from_ros,
    stamp_from_ros,
)
from sphere_nmpc.ros.settings import ControllerNodeSettings

_BYTES = 200
"""Size of a pose of the largest message: it is 80 without the name of its frame."""


class GoalReceiver:
    """Subscriptions of ``goal_pose``, ``goal_point``, ``goals`` and ``path``.

    A message that is not valid is refused as a whole, with a line in the log.

    Parameters
    ----------
    node : GuardedNode
        Node of the subscriptions.
    clock : ControlClock
        Clock for messages that have no stamp.
    frame : str
        Frame of the goals.
    radius : float
        Radius of the sphere [m].
    settings : callable
        Returns the settings at present.
    use : callable
        Takes the goals of a message.
    fault_log : FaultLog
        Log of refused messages.
    """

    def __init__(
        self, node: GuardedNode, clock: ControlClock, frame: str, radius: float,
        settings: Callable[[], ControllerNodeSettings], use: Callable[[ActiveCourse], None],
        fault_log: FaultLog,
    ) -> None:
        self._clock, self._frame, self._radius, self._settings = clock, frame, radius, settings
        self._use, self._fault_log = use, fault_log

        def subscribe(kind: Any, topic: str, read: Callable[[Any], Course]) -> Any:
            most, what = MOST_GOALS, "goals"
            if kind is PathMessage:
                most, what = MOST_PLACES, "poses"
            return node.create_subscription(
                kind, topic, lambda message: self._receive(message, topic, read), 1,
                event_callbacks=NO_EVENTS, largest=(_BYTES * most, f"{most} {what}"),
            )

        self._subscriptions = [
            subscribe(PoseStamped, "goal_pose", self._pose),
            subscribe(PointStamped, "goal_point", self._point),
            subscribe(Goals, "goals", self._list),
            subscribe(PathMessage, "path", self._path),
        ]

    def _receive(self, message: Any, topic: str, read: Callable[[Any], Course]) -> None:
        try:
            course = read(message)
        except InvalidStateError as error:
            self._fault_log.report(f"{topic} refused", f"{error}; the goal in force stays")
            return
        stamp = stamp_from_ros(message.header.stamp) or self._clock.stamp()
        self._use(ActiveCourse(course, stamp))

    def _pose(self, message: Any) -> Course:
        pose = framed_pose_from_ros(message, self._frame)
        return Course.of(Goal(pose, Orientation(self._settings().goal_orientation)))

    def _point(self, message: Any) -> Course:
        return Course.of(Goal(framed_point_from_ros(message, self._frame), Orientation.ANY))

    def _list(self, message: Any) -> Course:
        """Return the course of the goals of a list."""
        if not message.goals:
            raise InvalidStateError("goals", [], "one pose or more; ~/cancel stops")
        poses = framed_poses_from_ros(message.goals, message.header.frame_id, self._frame)
        orientation = Orientation(self._settings().goal_orientation)
        return Course.of(*(Goal(pose, orientation) for pose in poses))

    def _path(self, message: Any) -> Course:
        """Return the course along a path, to its place where that has no length."""
        places, settings = framed_places_from_ros(message, self._frame), self._settings()
        paths = Path.through(places, settings.path_tolerance, self._radius)
        orientation, end = Orientation(settings.path_end_orientation), None
        if orientation is not Orientation.ANY:
            end = Goal(pose_from_ros(message.poses[-1]), orientation)
        elif not paths:
            x, y = places[-1].tolist()
            end = Goal(upright_state(x, y, 0.0), orientation)
        return Course.along(*paths, end=end)
