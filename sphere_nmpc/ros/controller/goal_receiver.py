# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals by topic: a pose, a point, or several poses to be visited in order."""

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Goals

from sphere_nmpc.control.active_course import ActiveCourse
from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.ros.control_clock import ControlClock
from sphere_nmpc.ros.graph_monitor import NO_EVENTS
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.messages import (
    MOST_GOALS,
    framed_point_from_ros,
    framed_pose_from_ros,
    framed_poses_from_ros,
    stamp_from_ros,
)

_LARGEST = 200 * MOST_GOALS, f"{MOST_GOALS} goals"
"""Size of the largest message [bytes]: each has 80 without the name of its frame."""


class GoalReceiver:
    """Subscriptions of ``goal_pose``, ``goal_point`` and ``goals``.

    A message that is not valid is refused as a whole, with a line in the log.

    Parameters
    ----------
    node : GuardedNode
        Node of the subscriptions.
    clock : ControlClock
        Clock for messages that have no stamp.
    frame : str
        Frame of the goals.
    orientation : callable
        Returns what poses demand of the orientation at present, see `Orientation`.
    use : callable
        Takes the goals of a message.
    fault_log : FaultLog
        Log of refused messages.
    """

    def __init__(
        self, node: GuardedNode, clock: ControlClock, frame: str, orientation: Callable[[], str],
        use: Callable[[ActiveCourse], None], fault_log: FaultLog,
    ) -> None:
        self._clock, self._frame, self._orientation = clock, frame, orientation
        self._use, self._fault_log = use, fault_log

        def subscribe(kind: Any, topic: str, read: Callable[[Any], tuple[Goal, ...]]) -> Any:
            return node.create_subscription(
                kind, topic, lambda message: self._receive(message, topic, read), 1,
                event_callbacks=NO_EVENTS, largest=_LARGEST,
            )

        self._subscriptions = [
            subscribe(PoseStamped, "goal_pose", self._pose),
            subscribe(PointStamped, "goal_point", self._point),
            subscribe(Goals, "goals", self._list),
        ]

    def _receive(
        self, message: Any, topic: str, read: Callable[[Any], tuple[Goal, ...]]
    ) -> None:
        try:
            goals = read(message)
        except InvalidStateError as error:
            self._fault_log.report(f"{topic} refused", f"{error}; the goal in force stays")
            return
        stamp = stamp_from_ros(message.header.stamp) or self._clock.stamp()
        self._use(ActiveCourse(Course.of(*goals), stamp))

    def _pose(self, message: Any) -> tuple[Goal, ...]:
        pose = framed_pose_from_ros(message, self._frame)
        return (Goal(pose, Orientation(self._orientation())),)

    def _point(self, message: Any) -> tuple[Goal, ...]:
        return (Goal(framed_point_from_ros(message, self._frame), Orientation.ANY),)

    def _list(self, message: Any) -> tuple[Goal, ...]:
        """Return the goals of a list."""
        if not message.goals:
            raise InvalidStateError("goals", [], "one pose or more; ~/cancel stops")
        poses = framed_poses_from_ros(message.goals, message.header.frame_id, self._frame)
        return tuple(Goal(pose, Orientation(self._orientation())) for pose in poses)
