# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Where an odometry node begins that is started again or reset, and after a jump of its clock."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.serialization import serialize_message
from robot_at_rest import STEP, RobotAtRest
from std_srvs.srv import Trigger

from sphere_nmpc.model.state import (
    DEFAULT_START,
    Vector,
    angle_error,
    position_error,
    upright_state,
)
from sphere_nmpc.reporting.conditions import ERROR, OK
from sphere_nmpc.ros.messages import pose_to_ros

PLACE = upright_state(1.2, -0.4, 0.7)


def put(robot: RobotAtRest, pose: Vector) -> None:
    message = PoseWithCovarianceStamped()
    message.pose.pose = pose_to_ros(pose, 0, 0.3).pose
    robot.node._set_pose(serialize_message(message))


@pytest.fixture
def robot(graph) -> RobotAtRest:
    """Return a robot whose odometry has been calibrated and put at its place."""
    robot = RobotAtRest(graph)
    robot.start()
    robot.stay(2.5)
    put(robot, PLACE)
    robot.stay(1.5)
    return robot


def is_at_place(robot: RobotAtRest) -> bool:
    estimate = robot.node.odometry.estimate
    near = position_error(estimate.pose, PLACE) < 1e-3 and angle_error(estimate.pose, PLACE) < 0.02
    return bool(robot.poses) and robot.status[0] == OK and near


def assert_lost(robot: RobotAtRest, reason: str) -> None:
    level, message = robot.status
    assert level == ERROR and message.startswith("position not known: given the pose of "), message
    assert reason in message and "until pose_fix or initialpose gives it" in message
    assert not robot.poses and robot.node.odometry.faults.is_lost
    assert np.trace(robot.node.odometry.estimate.covariance[:2, :2]) > 1.0
    put(robot, PLACE)
    robot.stay(0.5)
    assert robot.status[0] != ERROR and robot.poses
    assert position_error(robot.node.odometry.estimate.pose, PLACE) < 1e-3


@pytest.mark.parametrize("ended", [True, False], ids=["ended", "killed"])
def test_node_goes_on_where_the_sphere_rests_as_it_did(robot, ended) -> None:
    if ended:
        robot.node.finish()
    robot.node._stored.close()
    robot.poses.clear()
    robot.start(initial_state=[9.0, 9.0, 1.0, 0.0, 0.0, 0.0])
    robot.stay(3.0)
    assert is_at_place(robot)
    deviation = float(robot.node._reports.report[2]["position_deviation_m"])
    assert 1e-3 < deviation < 0.01


def test_node_that_ends_in_motion_does_not_know_where_the_sphere_is(robot) -> None:
    robot.rate = np.array([0.0, 0.0, 0.5])
    robot.stay(0.5)
    robot.node._stored.close()  # killed: what was stored is stored
    robot.rate = np.zeros(3)
    robot.poses.clear()
    robot.start()
    robot.stay(3.0)
    assert_lost(robot, "where the sphere moved, expected one at rest")


def test_sphere_that_lies_otherwise_has_been_moved(robot) -> None:
    robot.node.finish()
    robot.poses.clear()
    robot.start()
    robot.gravity = 9.81 * np.array([0.0, 0.5, np.sqrt(0.75)])
    robot.stay(4.0)
    assert_lost(robot, "whose vertical is 30.")


def test_rotors_that_have_turned_have_moved_the_sphere(robot) -> None:
    robot.node.finish()
    robot.poses.clear()
    robot.start()
    robot.angles = robot.angles + 3.0
    robot.stay(3.0)
    assert_lost(robot, "with rotors at [1.0, -2.0] rad that are at [4.0, 1.0] rad now")


def test_encoders_that_count_anew_show_nothing(robot) -> None:
    robot.node.finish()
    robot.start()
    robot.angles = np.zeros(2)
    robot.stay(3.0)
    assert is_at_place(robot)


def test_place_that_is_lost_stays_lost(robot) -> None:
    robot.rate = np.array([0.0, 0.0, 0.5])
    robot.stay(0.5)
    robot.node._stored.close()
    robot.rate = np.zeros(3)
    robot.start()
    robot.stay(3.0)
    robot.node.finish()
    robot.poses.clear()
    robot.start()
    robot.stay(3.0)
    assert_lost(robot, "where the sphere moved")


@pytest.mark.parametrize("parameters", [{"pose_memory": 0.0}, {"frame_prefix": "x/"}])
def test_initial_state_holds_without_a_last_pose(robot, parameters) -> None:
    robot.node.finish()
    robot.now = 0 if "frame_prefix" in parameters else robot.now  # a simulation that starts again
    robot.start(initial_state=PLACE.tolist(), **parameters)
    robot.stay(3.0)
    assert is_at_place(robot)


def test_simulation_that_starts_again_has_the_sphere_at_its_start(robot) -> None:
    robot.now = 0
    robot.poses.clear()
    robot.stay(1.5)
    assert not robot.poses
    robot.stay(2.0)
    assert robot.poses and robot.status[1].startswith("tilt replaced")  # it lies upright
    assert position_error(robot.node.odometry.estimate.pose, np.array(DEFAULT_START)) < 1e-3


def test_reset_leaves_out_what_was_measured_before(robot) -> None:
    robot.node._reset(Trigger.Request(), Trigger.Response())
    robot.poses.clear()
    robot.now -= 50 * STEP
    robot.rate = np.array([3.0, 0.0, 0.0])
    for _ in range(50):  # still on their way
        robot.send()
    robot.rate = np.zeros(3)
    robot.stay(2.5)
    assert robot.poses and robot.status[1].startswith("tilt replaced")  # it lies upright
    assert position_error(robot.node.odometry.estimate.pose, np.array(DEFAULT_START)) < 1e-3
