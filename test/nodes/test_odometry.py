# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The odometry node over real DDS, in the loop with simulator and controller."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from patience import LOCKSTEP
from ros_graph import Graph, running_graph, values_of
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry_settings import OdometrySettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, Vector, angle_error, position_error, upright_state
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.ros.cdr_messages import clock_message
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_from_ros, pose_to_ros, stamp_from_ros, stamp_to_ros
from sphere_nmpc.ros.odometry.node import OdometryNode
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.world.robot_description import make_urdf

pytestmark = pytest.mark.slow

START = upright_state(1.0, -0.5, 0.4)
IMU = ImuSettings(position=(0.12, -0.05, 0.1), orientation=(0.5, 0.5, -0.5, 0.5))
GOAL = upright_state(1.6, 0.2, 1.0)
BACK = upright_state(1.0, -0.2, 0.0)
OFF = 0.3, -0.2
"""What a given position is off [m]."""
SETTINGS = OdometrySettings()
RVIZ = np.diag([0.25, 0.25, 0.0, 0.0, 0.0, 0.0685]).ravel()
"""Covariance that RViz sends by default."""


class Loop:
    """Simulator, odometry and controller in lockstep, and what they publish."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.truths = graph.collect(PoseStamped, "ground_truth/pose")
        self.poses = graph.collect(PoseStamped, "pose")
        self.odometries = graph.collect(Odometry, "odom")
        self.statuses = graph.collect(DiagnosticStatus, "odometry/status", LATCHED)
        self.imu = graph.collect(Imu, "imu")
        start = {"initial_state": START.tolist()}
        urdf = make_urdf(RobotParameters(), imu=IMU)
        self.node = graph.start(OdometryNode, use_sim_time=True, robot_description=urdf, **start)
        self.controller = graph.start(ControllerNode, use_sim_time=True, lockstep=True)
        self.simulator = graph.start(
            SimulatorNode, pose_source="odometry", real_time_factor=0.0, **LOCKSTEP, **start,
            **{"imu.position": list(IMU.position), "imu.orientation": list(IMU.orientation)},
        )
        graph.until(lambda: self.poses)

    @property
    def error(self) -> tuple[float, float]:
        """Errors of the newest pose that has a true one [m, rad]."""
        true = {stamp_from_ros(one.header.stamp): one for one in self.truths}
        seen = {stamp_from_ros(one.header.stamp): one for one in self.poses}
        newest = max(true.keys() & seen.keys())
        found = pose_from_ros(seen[newest]), pose_from_ros(true[newest])
        return position_error(*found), angle_error(*found)

    def bounds(self) -> tuple[float, float]:
        """Four deviations of the estimate, in position [m] and orientation [rad]."""
        position, heading, tilt = self.node.odometry.estimate.deviations
        return 4.0 * position, 4.0 * math.hypot(heading, tilt)

    def deviations(self) -> tuple[float, float]:
        """Return the deviations of position [m] and heading [rad] in the next status."""
        values = self.values()
        degrees = float(values["heading_deviation_deg"])
        return float(values["position_deviation_m"]), math.radians(degrees)

    def send(self, topic: str, pose: Vector, covariance: Any, stamp: int = 0) -> None:
        message = PoseWithCovarianceStamped()
        message.header.stamp = stamp_to_ros(stamp)
        message.pose.pose = pose_to_ros(pose, 0, 0.0).pose
        message.pose.covariance = covariance
        self.graph.send(topic, message)

    def values(self) -> dict[str, str]:
        """Return the values of the next status."""
        self.statuses.clear()
        self.graph.until(lambda: self.statuses)
        return values_of(self.statuses[-1])


@pytest.fixture(scope="module")
def loop() -> Iterator[Loop]:
    with running_graph() as graph:
        yield Loop(graph)


def test_poses_begin_after_the_calibration_with_the_stamps_of_the_readings(loop) -> None:
    assert loop.node.odometry.is_calibrated
    stamps = {stamp_from_ros(one.header.stamp) for one in loop.imu}
    loop.graph.until(lambda: len(loop.poses) > 5)
    given = [stamp_from_ros(one.header.stamp) for one in loop.poses]
    assert given[0] >= 2 * 10**9 and stamps.issuperset(given[:1])
    assert loop.poses[0].header.frame_id == "world"
    assert np.all(loop.error < np.array(loop.bounds()))
    # Nothing moves a sphere at rest, and its heading is little less certain after two seconds.
    given = SETTINGS.position_deviation * math.sqrt(2.0), SETTINGS.orientation_deviation
    assert loop.deviations() == pytest.approx(given, rel=0.1)
    values = loop.values()
    assert values["calibrated"] == "true" and "deg/s" in values["calibration"]


def test_goal_is_reached_as_the_true_pose_shows(loop) -> None:
    loop.graph.send_goal(GOAL)
    loop.graph.until(lambda: loop.controller.controller.at_goal)
    truth, (off, turned) = pose_from_ros(loop.truths[-1]), loop.bounds()
    assert position_error(truth, GOAL) < ControllerSettings.goal_tolerance + off
    assert angle_error(truth, GOAL) < 2.0 * ControllerSettings.goal_tolerance + turned
    # What a way costs: an error of the radius along it, one of the heading across it. The latter
    # grows by the remaining error of the gyroscopes' bias, by less than twice in some seconds.
    position, heading = loop.deviations()
    given, way = SETTINGS.position_deviation * math.sqrt(2.0), position_error(START, GOAL)
    assert SETTINGS.orientation_deviation < heading < 3.0 * SETTINGS.orientation_deviation
    least = math.hypot(given, SETTINGS.radius_deviation * way)
    places = np.array([pose_from_ros(each)[POSITION] for each in loop.truths])
    rolled = float(np.sum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    most = math.hypot(given, SETTINGS.radius_deviation * rolled, heading * rolled)
    assert least < position < most
    covariance = loop.odometries[-1].pose.covariance.reshape(6, 6)
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-15)
    # At rest, where the position is no less certain a moment later.
    assert np.sqrt(covariance[0, 0] + covariance[1, 1]) == pytest.approx(position, rel=1e-3)
    assert covariance[2, 2] == pytest.approx((0.3 * SETTINGS.radius_deviation) ** 2)


def test_initial_pose_of_rviz_moves_position_and_heading_and_leaves_the_tilt(loop) -> None:
    _, turned = loop.bounds()
    wrong = GOAL + np.array([*OFF, 0.0, 0.0, 0.0, 0.0])
    loop.send("initialpose", wrong, RVIZ)
    loop.graph.until(lambda: loop.error[0] > 0.5 * math.hypot(*OFF))
    # The heading is now that of the goal, at which the sphere is.
    assert loop.error[1] < 2.0 * ControllerSettings.goal_tolerance + turned
    # Of both coordinates, and of the heading.
    given = math.sqrt(2.0 * RVIZ[0]), math.sqrt(RVIZ[-1])
    assert loop.deviations() == pytest.approx(given, rel=1e-2)


def test_late_fix_corrects_the_pose_and_one_that_is_no_measurement_is_refused(loop) -> None:
    used, begun = int(loop.values()["fixes_used"]), loop.simulator.simulator.time
    loop.graph.until(lambda: loop.simulator.simulator.time > begun + 1.0)
    true = loop.truths[-20]
    variance = np.diag([1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-5]).ravel()
    bounds = 4.0 * np.sqrt([2e-6, 3e-5])  # four deviations
    loop.send("pose_fix", pose_from_ros(true), variance, stamp_from_ros(true.header.stamp))
    loop.graph.until(lambda: np.all(loop.error < bounds))
    assert int(loop.values()["fixes_used"]) == used + 1
    counts = loop.node._fault_log.counts
    for number, (covariance, stamp) in enumerate(((variance, 0), (-variance, 10**9)), 1):
        loop.send("pose_fix", GOAL, covariance, stamp)
        loop.graph.until(lambda number=number: counts["pose_fix refused"] == number)
    assert np.all(loop.error < bounds)


def test_no_pose_is_published_while_the_position_is_not_known(loop) -> None:
    node, controller = loop.node, loop.controller
    loop.graph.until(lambda: controller.controller.at_goal)
    arrivals = loop.graph.collect(Bool, "controller/at_goal", LATCHED)
    statuses = loop.graph.collect(DiagnosticStatus, "controller/status")
    node.odometry.faults.see(Kind.LIFTED, math.inf, "given a vertical velocity of +0.3 m/s")
    loop.graph.until(lambda: arrivals and not arrivals[-1].data)
    loop.poses.clear()
    loop.graph.until(lambda: loop.statuses[-1].level == DiagnosticStatus.ERROR)
    assert loop.statuses[-1].message.startswith("lifted: given a vertical velocity of +0.3 m/s")
    assert "no pose is published after that at [" in loop.statuses[-1].message
    begun = loop.simulator.simulator.time
    loop.graph.until(lambda: loop.simulator.simulator.time > begun + 1.0)
    loop.graph.until(lambda: "/odometry reports lifted" in statuses[-1].message)
    assert statuses[-1].level == DiagnosticStatus.ERROR and not loop.poses
    loop.send("initialpose", pose_from_ros(loop.truths[-1]), RVIZ)
    loop.graph.until(lambda: loop.poses)
    assert not node.odometry.faults.is_lost
    loop.graph.until(lambda: arrivals[-1].data)


def test_reading_of_what_is_not_measured_is_refused(loop) -> None:
    reading = Imu(header=loop.imu[-1].header)
    reading.angular_velocity.z = 1e3  # which would turn the pose by far more
    reading.angular_velocity_covariance[0] = -1.0
    before = loop.error
    loop.graph.send("imu", reading)
    loop.graph.until(lambda: loop.node._fault_log.counts["imu refused"])
    received = len(loop.poses)
    loop.graph.until(lambda: len(loop.poses) > received)
    assert loop.error == pytest.approx(before, abs=1e-3), "at rest it hardly changes"


def test_reset_of_the_simulator_in_motion_begins_both_anew(loop) -> None:
    begun = loop.simulator.simulator.time
    loop.graph.send_goal(BACK, round(begun * 1e9) + 1)
    loop.graph.until(lambda: np.abs(loop.simulator.simulator.plant.rotor_speeds).max() > 20.0)
    answer = loop.graph.call(Trigger, "simulator/reset")
    assert answer.success and answer.message.endswith("the odometry begins anew")
    reset_at = float(answer.message.partition("t = ")[2].partition(" s")[0])
    loop.graph.until(lambda: loop.simulator._begun_at < math.inf)
    begun_at = loop.simulator._begun_at

    def poses() -> list[PoseStamped]:
        """Return those since, as some of before may arrive later."""
        return [one for one in loop.poses if stamp_from_ros(one.header.stamp) > begun_at]

    loop.graph.until(lambda: len(poses()) > 5)
    first = poses()[0]
    assert stamp_from_ros(first.header.stamp) > 1e9 * (reset_at + 1.9)
    bounds = loop.bounds()
    assert position_error(pose_from_ros(first), START) < bounds[0]
    assert np.all(loop.error < np.array(bounds))


def test_reading_that_is_repeated_while_time_stands_still_gives_its_pose_again(loop) -> None:
    loop.graph.remove(loop.simulator)
    newest = max(loop.imu, key=lambda one: stamp_from_ros(one.header.stamp))
    stamp = stamp_from_ros(newest.header.stamp) + 10**7  # the simulator has sent none of then
    newest.header.stamp = stamp_to_ros(stamp)

    def is_given_again() -> bool:
        loop.graph.send("imu", newest)
        given = [stamp_from_ros(one.header.stamp) for one in loop.poses]
        return given.count(stamp) > 2

    loop.graph.until(is_given_again)


def test_clock_that_goes_back_begins_another_calibration(loop) -> None:
    loop.node._control_clock.hear(clock_message(0))
    # Before further readings: at full speed two seconds at rest may pass until the next status.
    assert not loop.node.odometry.is_calibrated
