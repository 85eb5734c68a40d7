# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Translation of goals, feedback and results, for older and newer versions of Nav2."""

import math
import sys
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from unittest.mock import Mock

import navigation_messages
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Goals, Path

from sphere_nmpc.control.goal_client import Ending, Missed, Outcome
from sphere_nmpc.control.goal_report import ERROR_CODES, GoalReport
from sphere_nmpc.errors import InvalidInputError, InvalidValueError
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.ros.messages import pose_from_ros, pose_to_ros
from sphere_nmpc.ros.navigator.requests import (
    action_types,
    feedback_of,
    result_of,
    stages_of,
    ways_of,
)

POSES = [[1.0, 2.0, 1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 1.0, 0.0, 0.0]]


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


GOALS = Goals(goals=[stamped(state) for state in POSES])


@pytest.mark.parametrize("frame", ["", "map"])
def test_poses_of_each_kind_of_goal_are_sent_in_the_frame_of_the_world(frame) -> None:
    for request in requests(frame):
        (goals,) = stages_of(request, "map")
        assert [pose.header.frame_id for pose in goals.goals] == ["map"]
        assert pose_from_ros(goals.goals[0]).tolist() == POSES[0]
    with pytest.raises(InvalidValueError, match=r"frame: given '?odom'?, expected 'map'"):
        stages_of(requests(common="odom")[2], "map")


@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda request, _: setattr(request, "behavior_tree", "a.xml"), "behavior_tree: given"),
        (lambda request, pose: setattr(pose.pose.position, "x", math.nan), "state: given .nan"),
        (lambda request, pose: setattr(pose.pose.orientation, "w", 0.5), "norm"),
        (lambda request, pose: setattr(pose.header, "frame_id", "odom"), "frame: given"),
    ],
    ids=["tree", "place", "turn", "frame"],
)
def test_goal_that_cannot_be_followed_is_refused(number, change, told) -> None:
    request = requests("world")[number]
    pose = request.pose if number == 0 else getattr(request.poses, "goals", request.poses)[0]
    change(request, pose)
    with pytest.raises(InvalidValueError, match=told):
        stages_of(request, "world")


def test_waypoints_are_sent_one_after_the_other() -> None:
    poses = [stamped(state) for state in POSES]
    request = SimpleNamespace(poses=poses, number_of_loops=0, goal_index=1)
    stages = stages_of(request, "world")
    assert [pose_from_ros(stage.goals[0]).tolist() for stage in stages] == POSES
    request.goal_index = 2
    with pytest.raises(InvalidInputError, match="goal_index: given 2, expected 0 to 1"):
        stages_of(request, "world")
    for empty in ([], Goals()):
        with pytest.raises(InvalidInputError, match=r"poses: given \[\], expected one pose"):
            stages_of(SimpleNamespace(poses=empty, behavior_tree=""), "world")


def test_more_poses_than_the_controller_takes_are_refused_whatever_they_are() -> None:
    for poses in (500, 501):
        many = [stamped(POSES[0])] * poses
        for about in ({"behavior_tree": ""}, {"number_of_loops": 0, "goal_index": 0}):
            request = SimpleNamespace(poses=many, **about)
            if poses == 500:
                assert sum(len(stage.goals) for stage in stages_of(request, "world")) == 500
                continue
            with pytest.raises(InvalidValueError, match="given 501 goals, expected at most 500"):
                stages_of(request, "world")


def test_feedback_has_what_is_left_of_all_as_far_as_it_is_known(kinds) -> None:
    report = GoalReport("", 2, 3, total_time_left=1.25, total_distance_left=2.5)
    kind = kinds["navigate_through_poses"]
    feedback = feedback_of(kind, report, 3.5, 0, stamped(POSES[1]), GOALS, None)
    assert feedback.number_of_poses_remaining == 1
    assert feedback.number_of_recoveries == 0
    assert feedback.distance_remaining == 2.5
    assert (feedback.navigation_time.sec, feedback.navigation_time.nanosec) == (3, 500_000_000)
    left = feedback.estimated_time_remaining
    assert (left.sec, left.nanosec) == (1, 250_000_000)
    assert pose_from_ros(feedback.current_pose).tolist() == POSES[1]
    pose, followed = stamped(POSES[1]), kinds["follow_waypoints"]
    assert feedback_of(followed, report, 0.0, 4, pose, GOALS, None).current_waypoint == 4
    feedback = feedback_of(kinds["navigate_to_pose"], GoalReport(), -1.0, 0, pose, GOALS, None)
    assert math.isnan(feedback.distance_remaining)
    assert feedback.estimated_time_remaining.sec == 2**31 - 1
    assert feedback.navigation_time.sec == 0


def test_path_is_sent_as_it_is_and_its_feedback_is_how_it_is_followed(kinds) -> None:
    path = Path(poses=[PoseStamped() for _ in range(4)])
    places = [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (3.0, 2.0)]
    for pose, (x, y) in zip(path.poses, places, strict=True):
        pose.header.frame_id = "map"
        pose.pose.position.x, pose.pose.position.y = x, y
    (sent,) = stages_of(SimpleNamespace(path=path, controller_id="a", goal_checker_id=""), "map")
    assert sent is path
    assert sent.header.frame_id == "map"
    with pytest.raises(InvalidValueError, match="frame: given 'map', expected 'world'"):
        stages_of(SimpleNamespace(path=path), "world")
    for poses in ([], [PoseStamped()] * 10_001):
        with pytest.raises(InvalidValueError, match=f"path: given {len(poses)} poses, expected 1"):
            stages_of(SimpleNamespace(path=Path(poses=poses)), "map")
    ways = ways_of(path)
    assert ways.tolist() == [0.0, 1.0, 3.0, 5.0]
    report = GoalReport("", total_distance_left=3.5, deviation=0.25, heading_error=0.5, speed=0.75)
    pose = stamped(POSES[0], "map")
    found = feedback_of(kinds["follow_path"], report, 0.0, 0, pose, path, ways)
    assert (found.distance_to_goal, found.speed) == (3.5, 0.75)
    kind = Mock(Feedback=partial(Mock, spec=["tracking_feedback"]))
    for left, index in ((7.0, 0), (3.5, 1), (1.0, 2), (0.0, 3), (math.nan, 0)):
        report = replace(report, total_distance_left=left)
        told = feedback_of(kind, report, 0.0, 0, pose, path, ways).tracking_feedback
        assert told.current_path_index == index
    # To the right of the path is a positive heading error there.
    assert (told.position_tracking_error, told.heading_tracking_error) == (0.25, -0.5)
    assert (told.header.frame_id, told.robot_pose, told.speed) == ("map", pose, 0.75)


def test_newer_versions_have_the_status_of_each_of_several_goals(monkeypatch) -> None:
    status = Mock(side_effect=SimpleNamespace)
    monkeypatch.setitem(sys.modules, "nav2_msgs.msg", Mock(WaypointStatus=status))
    made = partial(Mock, spec=["waypoint_statuses", "position_tracking_error"])
    kind, report = Mock(Feedback=made, Result=made), GoalReport("", 1, 2, deviation=0.25)
    told = feedback_of(kind, report, 0.0, 0, stamped(POSES[0]), GOALS, None)
    assert told.position_tracking_error == 0.25
    assert [one.waypoint_pose for one in told.waypoint_statuses] == GOALS.goals
    found = [(told, status.PENDING)]
    for outcome in Outcome:
        rest = status.COMPLETED if outcome is Outcome.SUCCEEDED else status.FAILED
        found.append((result_of(kind, Ending(b"a", outcome, "", passed=1), [GOALS]), rest))
    for message, rest in found:
        one, other = message.waypoint_statuses
        assert (one.waypoint_status, other.waypoint_status) == (status.COMPLETED, rest)
        assert (one.waypoint_index, other.waypoint_index) == (0, 1)


@pytest.mark.parametrize("outcome", Outcome)
def test_result_has_code_and_reason_where_the_message_has_them(kinds, outcome) -> None:
    for kind in kinds.values():
        result = result_of(kind, Ending(b"a", outcome, "the reason"), [GOALS])
        is_fault = outcome is Outcome.ABORTED
        assert bool(result.error_code) is is_fault
        assert result.error_msg == ("the reason" if is_fault else "")
    older = SimpleNamespace(Result=SimpleNamespace)
    assert result_of(older, Ending(b"a", outcome, "the reason"), []) == SimpleNamespace()


@pytest.mark.parametrize(("cause", "code"), [
    ("start outside", 203), ("goal outside", 204), ("start occupied", 205),
    ("goal occupied", 206), ("no way", 208), (Kind.NO_PROGRESS.value, 105),
    (Kind.NO_FRESH_POSE.value, 102), (Kind.DISABLED.value, 0),
])
def test_what_is_not_pursued_has_the_code_of_nav2_for_its_cause(kinds, cause, code) -> None:
    missed = (Missed(1, cause, "why"), Missed(3, cause, "why"))
    ending = Ending(b"a", Outcome.ABORTED, "why", missed)
    waypoints = [Goals(goals=[stamped(state)]) for state in POSES]
    for name, kind in kinds.items():
        result = result_of(kind, ending, waypoints, 1)
        beyond = 100 if name == "navigate_through_poses" and code > 200 else 0
        unknown = getattr(kind.Result, "UNKNOWN", 1)
        if name == "follow_path" and code > 200:
            beyond = 103 - code  # an invalid path
        if name == "follow_waypoints":
            assert result.error_code == unknown
            index, goal = navigation_messages.MISSED
            assert [getattr(one, index) for one in result.missed_waypoints] == [0, 0]
            of_goal = getattr(kinds["navigate_to_pose"].Result, "UNKNOWN", 1)
            assert {one.error_code for one in result.missed_waypoints} == {code or of_goal}
            missed_goal = getattr(result.missed_waypoints[0], goal)
            assert pose_from_ros(missed_goal).tolist() == POSES[0]
        else:
            assert result.error_code == (code + beyond or unknown)


def test_table_of_codes_knows_all_that_makes_a_goal_unreachable() -> None:
    unreachable = {kind.value for kind in Kind if kind.is_unreachable}
    assert len(unreachable) == 5 and unreachable < ERROR_CODES.keys()
