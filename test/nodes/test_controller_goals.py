# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals, lists and paths of the controller node over real DDS, and their end."""

import math
import re

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from driven_controller import (
    CASE,
    ON_THE_WAY,
)
from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Goals, Path
from rclpy.parameter import Parameter
from std_msgs.msg import Bool, Float64
from std_srvs.srv import SetBool

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.state import upright_state
from sphere_nmpc.quantities import stamp_text
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_from_ros, pose_to_ros, stamp_from_ros

pytestmark = pytest.mark.slow


def several(number: int, **changes: float) -> Goals:
    """Return goals, of which the first has a changed position or orientation."""
    goals = Goals(goals=[pose_to_ros(CASE.start, 0, 0.3, "") for _ in range(number)])
    for name, value in changes.items():
        first = goals.goals[0].pose
        setattr(first.orientation if name == "w" else first.position, name, value)
    return goals


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (several(1, w=0.5).goals[0], "goal_pose refused: .* expected norm 1"),
        (several(2, x=math.nan), "goals refused: .* expected finite numbers"),
        (several(0), "goals refused: .*given \\[\\]"),
        (several(501), "goals refused: goals: given 501 goals, expected at most 500; the goal "
         "in force stays"),
        (several(20_000), "goals refused: goals: given 1440028 bytes, expected at most 500"),
    ],
    ids=["norm", "nan", "none", "many", "too many to be read"],
)
def test_goal_that_cannot_be_used_is_told_and_the_one_in_force_stays(
    robot, capfd, message, told
) -> None:
    robot.send_goal()
    topic = "goals" if isinstance(message, Goals) else "goal_pose"
    robot.graph.send(topic, message)
    robot.graph.until(lambda: robot.node._fault_log.counts[f"{topic} refused"] == 1)
    assert re.search(told, capfd.readouterr().err)
    np.testing.assert_array_equal(robot.node.controller.goal, CASE.goal)
    assert len(robot.goals) == 1


def test_arrival_is_published_until_there_is_another_goal(begun, capfd) -> None:
    robot = begun
    arrivals = robot.graph.collect(Bool, "controller/at_goal", LATCHED)
    robot.graph.until(lambda: arrivals and not arrivals[-1].data)
    robot.send_goal(CASE.start)
    robot.pass_time(0.3)
    assert not arrivals[-1].data, "not before it has stayed for a sample period"
    robot.pass_time(0.7)
    robot.graph.until(lambda: arrivals[-1].data)
    assert robot.status()["mode"] == "at the goal"
    newest = robot.reported[-1]
    assert newest.message == "at the goal" or newest.level != DiagnosticStatus.OK
    assert capfd.readouterr().err.count("arrival: at the goal after 0.00 s, error 0\n") == 1
    robot.statuses.clear()
    for stamp in (5, 6):  # without an instant between
        robot.graph.send_goal(CASE.goal, stamp)
        robot.graph.until(lambda: robot.shown(f"0.{stamp:09}"))  # noqa: B023
    for status in robot.shown("0.000000005") + robot.shown("0.000000006"):
        assert status["mode"] != "at the goal"
    robot.graph.until(lambda: not arrivals[-1].data)
    robot.until_on_the_way()
    assert [arrival.data for arrival in arrivals] == [False, True, False]


def test_new_goal_shows_nothing_of_one_that_was_given_up(robot) -> None:
    free = Grid(np.zeros((60, 60), dtype=bool), 0.1, (-1.0, -6.0, 0.0))
    robot.node.controller.floor = Floor(free, 0.3, 0.02)
    robot.send_goal(upright_state(-9.0, 0.0, 0.0))
    robot.pass_time(8.0)
    status = robot.status()
    assert (status["mode"], status["unreachable"]) == (
        "no progress towards the goal", "goal outside"
    )
    assert float(status["total_distance_left_m"]) > 9.0
    robot.node.controller.floor = None
    robot.statuses.clear()
    robot.graph.send_goal(CASE.goal, 7)
    robot.graph.until(lambda: robot.shown("0.000000007"))
    first = robot.shown("0.000000007")[0]
    assert first["mode"] == ON_THE_WAY
    assert first["unreachable"] == first["giving_up"] == first["no_progress"] == ""
    assert float(first["total_time_left_s"]) > 2.0, "along a straight line until there is a plan"


def test_point_and_list_are_goals_known_by_their_stamps(robot, capfd) -> None:
    eta = robot.graph.collect(Float64, "controller/eta", 10)
    point = PointStamped()
    point.header.stamp.sec, point.header.stamp.nanosec = 7, 42
    point.point.x = float(CASE.start[0])
    point.point.y = float(CASE.start[1])
    robot.graph.send("goal_point", point)
    robot.graph.until(lambda: robot.goals)
    robot.pass_time(1.0)
    status = robot.status()
    assert status["goal_stamp"] == "7.000000042"
    assert status["mode"] == "at the goal", "whatever its orientation"
    robot.graph.until(lambda: eta and eta[-1].data == 0.0)
    assert status["goal_orientation"] == "any" and float(status["angle_error_rad"]) == 0.0
    assert status["active_goal_stamp"] == stamp_text(stamp_from_ros(robot.goals[-1].header.stamp))
    told = f"goal: {[round(float(v), 4) for v in CASE.start[:2]]}, position only\n"
    assert told in capfd.readouterr().err

    both = [pose_to_ros(goal, 0, 0.3) for goal in (CASE.start, CASE.goal)]
    robot.graph.send("goals", Goals(goals=both))
    robot.graph.until(lambda: robot.status()["goal_count"] == "2")
    robot.pass_time(1.0)
    status = robot.status()
    assert (status["goal_index"], status["goal_count"]) == ("1", "2"), "the first was reached"
    # Of goals that follow each other at once a subscription may receive the last one alone.
    robot.graph.until(lambda: len(robot.goals) > 1)
    robot.graph.until(lambda: np.allclose(pose_from_ros(robot.goals[-1]), CASE.goal, atol=1e-12))
    assert status["goal_orientation"] == "full"
    assert status["active_goal_stamp"] == stamp_text(stamp_from_ros(robot.goals[-1].header.stamp))


def path_of(*places: tuple[float, float], frame: str = "") -> Path:
    """Return the path of poses with quaternions of zeros, as planners send them."""
    path = Path(poses=[PoseStamped() for _ in places])
    path.header.frame_id = frame
    for pose, (x, y) in zip(path.poses, places, strict=True):
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation.w = 0.0
    return path


def test_path_is_followed_and_shown_and_one_without_a_length_is_a_place(robot, capfd) -> None:
    shown = robot.graph.collect(Path, "controller/path", LATCHED)
    x, y = CASE.start[:2].tolist()
    corner = path_of((x, y), (x + 1.0, y), (x + 1.0, y + 1.0))
    corner.header.stamp.sec = 7
    robot.graph.send("path", corner)
    robot.graph.until(lambda: shown and shown[-1].poses)
    places = np.array([pose_from_ros(pose)[:2] for pose in shown[-1].poses])
    np.testing.assert_allclose(places[[0, -1]], [[x, y], [x + 1.0, y + 1.0]], atol=1e-9)
    away = np.minimum(abs(places[:, 1] - y), abs(places[:, 0] - x - 1.0))
    assert 0.0 < away.max() < 0.02, "corners are cut within path_tolerance"
    heading = shown[-1].poses[-1].pose.orientation
    assert (heading.w, heading.z) == pytest.approx((0.5**0.5, 0.5**0.5), abs=1e-3)
    assert shown[-1].header.stamp.sec == 7
    robot.pass_time(0.3)
    status = robot.status()
    assert (status["goal_stamp"], status["goal_count"]) == ("7.000000000", "1")
    assert status["goal_orientation"] == "any"
    told = f"m along a path to [{x + 1.0}, {y + 1.0}], position only\n"
    assert told in capfd.readouterr().err

    there_and_back = path_of((x, y), (x + 1.0, y), (x, y))
    there_and_back.poses[-1].pose.orientation.w = 1.0
    for demanded, legs in (("full", "3"), ("any", "2")):
        given = Parameter("path_end_orientation", value=demanded)
        assert robot.node.set_parameters([given])[0].successful
        robot.graph.send("path", there_and_back)
        robot.graph.until(lambda legs=legs: robot.status()["goal_count"] == legs)
    robot.graph.send("path", path_of((1.0, 2.0), (1.0, 2.0)))
    robot.graph.until(lambda: not shown[-1].poses)
    assert str(robot.node.controller.active.goal) == "[1.0, 2.0], position only"


@pytest.mark.parametrize(("path", "told"), [
    (path_of(), "path: given 0 poses, expected 1 to 10000; ~/cancel stops"),
    (path_of((0.0, 0.0), (1.0, math.nan)), "pose 1 of the path: given [1.0, nan], expected fin"),
    (path_of((0.0, 0.0), (1.0, 0.0), frame="odom"), "frame: given 'odom', expected 'world'"),
])
def test_path_that_cannot_be_followed_is_refused(robot, capfd, path, told) -> None:
    robot.graph.send("path", path)
    printed = ""

    def is_told() -> bool:
        nonlocal printed
        printed += capfd.readouterr().err
        return f"path refused: {told}" in printed

    robot.graph.until(is_told)
    assert robot.node.controller.active is None
    assert printed.count("the goal in force stays") == 1


@pytest.mark.parametrize("driven", [{"goal_memory": 30.0}], indirect=True)
def test_goal_in_force_is_restored_after_a_restart_where_wanted(robot) -> None:
    robot.send_goal()
    robot.pass_time(0.5)
    robot.start_again(goal_memory=0.0)
    assert robot.node.controller.goal is None
    robot.start_again(goal_memory=30.0)
    np.testing.assert_allclose(robot.node.controller.goal, CASE.goal, atol=1e-12)
    robot.graph.until(lambda: len(robot.goals) == 2)
    robot.call(SetBool, "enable", data=False)
    robot.start_again(goal_memory=30.0)
    assert robot.node.controller.goal is None
