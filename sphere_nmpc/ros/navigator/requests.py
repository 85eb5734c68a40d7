# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages of the actions of Nav2, checked and translated."""

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from nav_msgs.msg import Goals, Path

from sphere_nmpc.control.goal_client import Ending, Missed, Outcome
from sphere_nmpc.control.goal_report import ERROR_CODES, GoalReport
from sphere_nmpc.errors import InvalidInputError, SphereNmpcError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.ros.messages import framed_places_from_ros, framed_poses_from_ros

_INSTALL = f"apt install ros-{os.environ.get('ROS_DISTRO', 'jazzy')}-nav2-msgs"
_LARGEST = 2**15 - 1
"""Largest count in a message of the actions."""
_LONGEST = 2**31 - 1
"""Longest duration in a message [s], which stands for one that is not known."""


class MissingPackageError(SphereNmpcError):
    """The package with the types of the actions is not installed."""


def action_types() -> dict[str, Any]:
    """Return the types of the actions by their names, from nav2_msgs.

    `MissingPackageError` says how to install the package where it is missing.
    """
    try:
        from nav2_msgs.action import (
            FollowPath,
            FollowWaypoints,
            NavigateThroughPoses,
            NavigateToPose,
        )
    except ImportError as error:
        missing = "'nav2_msgs' is not installed" if error.name == "nav2_msgs" else str(error)
        raise MissingPackageError(f"{missing}; {_INSTALL}") from None
    return {
        "navigate_to_pose": NavigateToPose, "navigate_through_poses": NavigateThroughPoses,
        "follow_waypoints": FollowWaypoints, "follow_path": FollowPath,
    }


def stages_of(request: Any, frame: str) -> list[Goals] | list[Path]:
    """Return what is to be sent for a goal of an action, in `frame`, without a stamp.

    That is one message with all poses, and for `FollowWaypoints` one for each of them; for
    `FollowPath` its path.

    The poses of `NavigateThroughPoses` are a list or, in newer versions of Nav2, a message Goals,
    whose frame is that of poses without one. `InvalidStateError` or `InvalidInputError` is raised
    for a goal that cannot be followed.
    """
    if tree := getattr(request, "behavior_tree", ""):
        raise InvalidInputError("behavior_tree", tree, "none")
    if hasattr(request, "path"):
        framed_places_from_ros(request.path, frame)
        request.path.header.frame_id = frame
        return [request.path]
    common = ""
    if hasattr(request, "pose"):
        poses = [request.pose]
    elif hasattr(request.poses, "goals"):
        poses, common = request.poses.goals, request.poses.header.frame_id
    else:
        poses = request.poses
    if not poses:
        raise InvalidInputError("poses", list(poses), "one pose or more")
    framed_poses_from_ros(poses, common, frame)
    for pose in poses:
        pose.header.frame_id = frame
    is_route = hasattr(request, "number_of_loops")
    first = request.goal_index if is_route else 0
    if first >= len(poses):
        raise InvalidInputError("goal_index", first, f"0 to {len(poses) - 1}")
    stages = [Goals(goals=some) for some in ([[pose] for pose in poses] if is_route else [poses])]
    for goals in stages:
        goals.header.frame_id = frame
    return stages


def ways_of(path: Path) -> Vector:
    """Return the lengths of a path up to each of its poses [m], shape (P,)."""
    places = framed_places_from_ros(path, path.header.frame_id)
    sides = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return np.concatenate(([0.0], np.cumsum(sides)))


def result_of(
    kind: Any, ending: Ending, waypoints: Sequence[Goals | Path], first: int = 0
) -> Any:
    """Return the result of an action, with code and reason as far as this version has them.

    `waypoints` are the stages of the goal, which begins with the one of index `first`.
    """
    result = kind.Result()
    values: dict[str, Any] = {}
    if hasattr(result, "missed_waypoints"):
        values["missed_waypoints"] = [
            _missed_waypoint(missed, (first + missed.stage) % len(waypoints), waypoints)
            for missed in ending.missed
        ]
    if hasattr(result, "waypoint_statuses"):
        is_reached = ending.outcome is Outcome.SUCCEEDED
        values["waypoint_statuses"] = _statuses(
            waypoints[0], ending.passed, "COMPLETED" if is_reached else "FAILED"
        )
    if ending.outcome is Outcome.ABORTED:
        values |= {"error_code": _code(kind, ending), "error_msg": ending.reason}
    return _fill(result, values)


def _fill(message: Any, values: Mapping[str, Any]) -> Any:
    """Set the values of those fields that a message has in the installed version of Nav2."""
    for name, value in values.items():
        if hasattr(message, name):
            setattr(message, name, value)
    return message


def _code(kind: Any, ending: Ending) -> int:
    """Return the code of a goal that was aborted."""
    unknown: int = getattr(kind.Result, "UNKNOWN", 1)
    if not ending.missed or hasattr(kind.Result(), "missed_waypoints"):
        return unknown
    code = ERROR_CODES.get(ending.missed[-1].cause, unknown)
    if 200 <= code < 300 and hasattr(kind.Goal(), "path"):
        return getattr(kind.Result, "INVALID_PATH", unknown)
    # ComputePathThroughPoses has codes of its own, in the same order.
    return code + 100 if 200 <= code < 300 and hasattr(kind.Goal(), "poses") else code


def _missed_waypoint(missed: Missed, index: int, waypoints: Sequence[Any]) -> Any:
    """Return the message about a waypoint that was missed, as this version of Nav2 has it."""
    from nav2_msgs.action import NavigateToPose

    unknown = getattr(NavigateToPose.Result, "UNKNOWN", 1)
    code, pose = ERROR_CODES.get(missed.cause, unknown), waypoints[index].goals[0]
    try:
        from nav2_msgs.msg import MissedWaypoint
    except ImportError:
        from nav2_msgs.msg import WaypointStatus

        return WaypointStatus(
            waypoint_status=WaypointStatus.FAILED, waypoint_index=index, waypoint_pose=pose,
            error_code=code, error_msg=missed.reason,
        )
    return MissedWaypoint(index=index, goal=pose, error_code=code)


def _statuses(goals: Any, passed: int, others: str) -> list[Any]:
    """Return the status of each of several goals, of which the first ones have been passed."""
    from nav2_msgs.msg import WaypointStatus as Status

    return [
        Status(
            waypoint_status=Status.COMPLETED if index < passed else getattr(Status, others),
            waypoint_index=index, waypoint_pose=pose,
        ) for index, pose in enumerate(goals.goals)
    ]


def feedback_of(
    kind: Any, report: GoalReport, since: float, waypoint: int, pose: Any, message: Goals | Path,
    ways: Vector | None,
) -> Any:
    """Return the feedback of an action.

    `since` is the time since the goal was accepted [s], `waypoint` the index of the one of
    `follow_waypoints`, `pose` the newest one of the sphere, `message` what is sent for the goal,
    and `ways` are those of `ways_of` the path of `follow_path`.
    """
    feedback, left = kind.Feedback(), report.total_distance_left
    values = {
        "current_waypoint": waypoint, "current_pose": pose, "robot_pose": pose,
        "header": pose.header, "navigation_time": _duration(since),
        "estimated_time_remaining": _duration(report.total_time_left),
        "distance_remaining": left, "distance_to_goal": left, "remaining_path_length": left,
        "speed": report.speed, "position_tracking_error": report.deviation,
        "heading_tracking_error": -report.heading_error,  # positive to the right
        "number_of_poses_remaining": min(max(0, report.count - report.index), _LARGEST),
    }
    if ways is not None:
        way = ways[-1] - np.fmin(left, ways[-1])  # none where it is not known
        values["current_path_index"] = int(np.searchsorted(ways, way, "right")) - 1
    if hasattr(feedback, "waypoint_statuses"):
        values["waypoint_statuses"] = _statuses(message, report.index, "PENDING")
    # Of newer versions the feedback of follow_path has one message with all.
    _fill(getattr(feedback, "tracking_feedback", feedback), values)
    return feedback


def _duration(time: float) -> Duration:
    """Return a time [s] from 0 on as a message; the longest one where it is not known."""
    if not time < _LONGEST:
        return Duration(sec=_LONGEST)
    seconds, nanoseconds = divmod(max(0, round(time * NANOSECONDS)), NANOSECONDS)
    return Duration(sec=seconds, nanosec=nanoseconds)
