# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Arguments of the goal command, and the messages that they become."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Goals

from sphere_nmpc.ros.messages import pose_from_ros
from sphere_sim.ros.session.goal_arguments import parse
from sphere_sim.scenario.scenarios import PAPER_CASES

UPRIGHT = [1.0, 0.0, 0.0, 0.0]
HALF_TURN = [0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["1", "-2.5"], [1, -2.5, 1, 0, 0, 0]),
        (["0", "0", "--yaw", str(math.pi)], [0, 0, 0, 0, 0, 1]),
        (["0", "0", "--yaw", "-90", "--degrees"], [0, 0, 0.5**0.5, 0, 0, -(0.5**0.5)]),
        (["-1", "2", "--quaternion", "0.5", "-0.5", "0.5", "0.5"], [-1, 2, 0.5, -0.5, 0.5, 0.5]),
        (["--case", "2"], PAPER_CASES[2].goal),
    ],
)
def test_arguments_name_a_goal(arguments, expected) -> None:
    request = parse(arguments)
    assert len(request.goals) == 1 and isinstance(request.message, PoseStamped)
    np.testing.assert_allclose(request.goals[0], expected, atol=1e-5)
    np.testing.assert_allclose(pose_from_ros(request.message), expected, atol=1e-5)


def test_point_is_a_position_alone() -> None:
    request = parse(["1", "-2.5", "--point"])
    assert isinstance(request.message, PointStamped)
    assert (request.message.point.x, request.message.point.y) == (1.0, -2.5)
    assert str(request) == "goal x 1 y -2.5 m, any orientation"


def test_several_goals_are_sent_in_order() -> None:
    request = parse(["1", "0", "--then", "-1", "-2.5", "180", "--then", "0", "3", "--degrees"])
    assert isinstance(request.message, Goals)
    sent = [pose_from_ros(goal) for goal in request.message.goals]
    expected = [[1, 0, *UPRIGHT], [-1, -2.5, *HALF_TURN], [0, 3, *UPRIGHT]]
    np.testing.assert_allclose(sent, expected, atol=1e-12)
    assert str(request).startswith("3 goals, the last one x 0 y 3 m, quaternion")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["1"], "given 1 numbers"),
        (["1", "2", "--case", "1"], "--case brings its own"),
        (["1", "2", "--quaternion", "1", "1", "0", "0"], "norm 1.41421"),
        (["1", "2", "--yaw", "90"], "--yaw: given 90 rad, expected -6.283 to 6.283; --degrees"),
        (["1", "2", "--yaw", "nan"], "--yaw: given nan, expected a finite number"),
        (["1", "inf"], "given inf, expected a finite number"),
        (["1", "2", "--quaternion", "1", "0", "0", "nan"], "--quaternion: given nan, expected"),
        (["1", "2", "--timeout", "nan"], "--timeout: given nan, expected a number from 0 on"),
        (["1", "2", "--timeout", "inf"], "--timeout: given inf, expected a number from 0 on"),
        (["1", "2", "--timeout", "-1"], "--timeout: given -1, expected a number from 0 on"),
        (["1", "2", "--degrees"], "--degrees: given without --yaw"),
        (["1", "2", "--then", "3"], "--then: given 1 numbers, expected X Y or X Y YAW"),
        (["1", "2", "--then", "3", "4", "90"], "--then: given 90 rad"),
        (["1", "2", "--then", "3", "nan"], "--then: given nan, expected a finite number"),
        (["1", "2", "--point", "--then", "3", "4"], "--point: given with further goals"),
        (["1", "2", "--point", "--yaw", "1"], "not allowed with"),
        (["1", "2", "--cancel-on-interrupt"], "given without --wait"),
    ],
)
def test_wrong_arguments_exit_with_2(arguments, message, capsys) -> None:
    with pytest.raises(SystemExit, match="2"):
        parse(arguments)
    assert message in capsys.readouterr().err
