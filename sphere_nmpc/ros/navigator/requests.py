# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages of the actions of Nav2 and of the controller's status, checked and translated."""

import math
from collections.abc import Mapping
from typing import Any

from builtin_interfaces.msg import Duration
from nav_msgs.msg import Goals

from sphere_nmpc.control.navigation import Ending, GoalReport, Outcome
from sphere_nmpc.errors import InvalidInputError, SphereNmpcError
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.ros.messages import framed_poses_from_ros

_INSTALL = "apt install ros-jazzy-nav2-msgs"
_LARGEST = 2**15 - 1
"""Largest count in a message of the actions."""


class MissingPackageError(SphereNmpcError):
    """The package with the types of the actions is not installed."""


def action_types() -> dict[str, Any]:
    """Return the types of the actions by their names, from nav2_msgs.

    `MissingPackageError` says how to install the package where it is missing.
    """
    try:
        from nav2_msgs.action import NavigateThroughPoses, NavigateToPose
    except ImportError as error:
        missing = "'nav2_msgs' is not installed" if error.name == "nav2_msgs" else str(error)
        raise MissingPackageError(f"{missing}; {_INSTALL}") from None
    return {"navigate_to_pose": NavigateToPose, "navigate_through_poses": NavigateThroughPoses}


def goals_of(request: Any, frame: str) -> Goals:
    """Return the poses of a goal of either action, all of them in `frame`, without a stamp.

    The poses of `NavigateThroughPoses` are a list or, in newer versions of Nav2, a message Goals,
    whose frame is that of poses without one. `InvalidStateError` or `InvalidInputError` is raised
    for a goal that cannot be followed.
    """
    if request.behavior_tree:
        raise InvalidInputError("behavior_tree", request.behavior_tree, "none")
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
    goals = Goals(goals=poses)
    goals.header.frame_id = frame
    return goals


def report_of(values: Mapping[str, str]) -> GoalReport:
    """Return what a status of the controller with these values says about its goals.

    Before its first sampling instant a controller tells nothing of plans and commands.
    """
    try:
        return GoalReport(
            values["goal_stamp"], int(values["goal_index"]), values["mode"],
            values.get("at_rest") == "true", int(values.get("plans", 0)),
            float(values.get("time_left_s", math.nan)),
            float(values.get("distance_left_m", math.nan)),
        )
    except (KeyError, ValueError) as error:
        expected = "goal_stamp, goal_index, mode, plans, time_left_s, distance_left_m"
        raise InvalidInputError("values of controller/status", str(error), expected) from None


def result_of(kind: Any, ending: Ending) -> Any:
    """Return the result of an action, with code and reason as far as this version has them."""
    result = kind.Result()
    if ending.outcome is Outcome.ABORTED:
        if hasattr(result, "error_code"):
            result.error_code = getattr(kind.Result, "UNKNOWN", 1)
        if hasattr(result, "error_msg"):
            result.error_msg = ending.reason
    return result


def feedback_of(
    kind: Any, report: GoalReport | None, since: float, replans: int, count: int, pose: Any
) -> Any:
    """Return the feedback of an action; what is not known yet is 0.

    `since` is the time since the goal was accepted [s], `count` the number of its poses, `pose`
    the newest one of the sphere, or None.
    """
    feedback = kind.Feedback()
    if pose is not None:
        feedback.current_pose = pose
    feedback.navigation_time = _duration(since)
    feedback.number_of_recoveries = min(replans, _LARGEST)
    done = 0
    if report is not None:
        done = report.index
        feedback.estimated_time_remaining = _duration(report.time_left)
        if math.isfinite(report.distance_left):
            feedback.distance_remaining = report.distance_left
    if hasattr(feedback, "number_of_poses_remaining"):
        feedback.number_of_poses_remaining = min(max(0, count - done), _LARGEST)
    return feedback


def _duration(time: float) -> Duration:
    """Return a time [s] as a message; 0 where it is not known or negative."""
    whole = round(time * NANOSECONDS) if math.isfinite(time) else 0
    seconds, nanoseconds = divmod(max(0, whole), NANOSECONDS)
    return Duration(sec=min(seconds, 2**31 - 1), nanosec=nanoseconds)
