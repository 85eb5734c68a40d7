# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Translation of goals, feedback and results, for older and newer versions of Nav2."""

import math
from types import SimpleNamespace

import navigation_messages
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Goals

from sphere_nmpc.control.navigation import Ending, GoalReport, Outcome
from sphere_nmpc.errors import InvalidInputError, InvalidValueError
from sphere_nmpc.ros.messages import pose_from_ros, pose_to_ros
from sphere_nmpc.ros.navigator.requests import (
    action_types,
    feedback_of,
    goals_of,
    report_of,
    result_of,
)

POSES = [[1.0, 2.0, 1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 1.0, 0.0, 0.0]]
VALUES = {"goal_stamp": "7.000000001", "goal_index": "1", "mode": "at the goal"}


@pytest.fixture(scope="module")
def kinds() -> dict:
    navigation_messages.provide()
    return action_types()


def stamped(state, frame: str = "") -> PoseStamped:
    return pose_to_ros(np.array(state), 0, 0.3, frame)


def requests(frame: str = "", common: str = "") -> list[SimpleNamespace]:
    """Return goals of the two actions, and one as in newer versions, to the same pose."""
    pose = stamped(POSES[0], frame)
    goals = Goals(goals=[pose])
    goals.header.frame_id = common
    return [
        SimpleNamespace(pose=pose, behavior_tree=""),
        SimpleNamespace(poses=[pose], behavior_tree=""),
        SimpleNamespace(poses=goals, behavior_tree=""),
    ]


@pytest.mark.parametrize("frame", ["", "map"])
def test_poses_of_each_kind_of_goal_are_sent_in_the_frame_of_the_world(frame) -> None:
    for request in requests(frame):
        goals = goals_of(request, "map")
        assert [pose.header.frame_id for pose in goals.goals] == ["map"]
        assert pose_from_ros(goals.goals[0]).tolist() == POSES[0]


def test_frame_of_a_list_is_that_of_poses_without_one() -> None:
    with pytest.raises(InvalidValueError, match=r"frame: given '?odom'?, expected 'map'"):
        goals_of(requests(common="odom")[2], "map")


@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda request, _: setattr(request, "behavior_tree", "a.xml"), "behavior_tree: given"),
        (lambda request, pose: setattr(pose.pose.position, "x", math.nan), "state: given .nan"),
        (lambda request, pose: setattr(pose.pose.orientation, "w", 0.5), "norm"),
        (lambda request, pose: setattr(pose.header, "frame_id", "odom"), "frame: given"),
    ],
)
def test_goal_that_cannot_be_followed_is_refused(number, change, told) -> None:
    request = requests("world")[number]
    pose = request.pose if number == 0 else getattr(request.poses, "goals", request.poses)[0]
    change(request, pose)
    with pytest.raises(InvalidValueError, match=told):
        goals_of(request, "world")


def test_empty_list_is_refused() -> None:
    for empty in ([], Goals()):
        with pytest.raises(InvalidInputError, match="poses: given \\[\\], expected one pose"):
            goals_of(SimpleNamespace(poses=empty, behavior_tree=""), "world")


def test_status_of_a_controller_that_has_not_planned_yet_is_read() -> None:
    report = report_of(VALUES)
    assert (report.stamp, report.index, report.plans) == ("7.000000001", 1, 0)
    assert math.isnan(report.time_left) and not report.at_rest
    more = {"at_rest": "true", "plans": "3", "time_left_s": "1.5", "distance_left_m": "0.25"}
    assert report_of(VALUES | more) == GoalReport(
        "7.000000001", 1, "at the goal", True, 3, 1.5, 0.25
    )
    for wrong in ({"mode": "no goal"}, VALUES | {"plans": "many"}):
        with pytest.raises(InvalidInputError, match="values of controller/status"):
            report_of(wrong)


def test_feedback_has_what_is_known(kinds) -> None:
    kind = kinds["navigate_through_poses"]
    feedback = feedback_of(kind, None, -1.0, 0, 3, None)
    assert feedback.number_of_poses_remaining == 3
    assert feedback.navigation_time.sec == feedback.estimated_time_remaining.sec == 0
    report = GoalReport("", 2, "", False, 0, 1.25, math.nan)
    feedback = feedback_of(kind, report, 3.5, 10**6, 3, stamped(POSES[1]))
    assert feedback.number_of_poses_remaining == 1
    assert feedback.number_of_recoveries == 2**15 - 1
    assert feedback.distance_remaining == 0.0
    assert (feedback.navigation_time.sec, feedback.navigation_time.nanosec) == (3, 500_000_000)
    assert feedback.estimated_time_remaining.nanosec == 250_000_000
    assert pose_from_ros(feedback.current_pose).tolist() == POSES[1]


@pytest.mark.parametrize("outcome", Outcome)
def test_result_has_code_and_reason_where_the_message_has_them(kinds, outcome) -> None:
    for kind in kinds.values():
        result = result_of(kind, Ending(b"a", outcome, "the reason"))
        is_fault = outcome is Outcome.ABORTED
        assert bool(result.error_code) is is_fault
        assert result.error_msg == ("the reason" if is_fault else "")
    older = SimpleNamespace(Result=SimpleNamespace)
    assert result_of(older, Ending(b"a", outcome, "the reason")) == SimpleNamespace()
