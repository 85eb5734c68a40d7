# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes of a beginner are logged once, with cause and remedy, as documented."""

import re
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import navigation_messages
import pytest
from action_msgs.msg import GoalStatusArray
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import (
    Point32,
    PolygonInstanceStamped,
    PoseStamped,
    PoseWithCovarianceStamped,
)
from given_plans import Standing
from patience import LOCKSTEP
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState

from sphere_nmpc.foreign.own_folder import cache_folder
from sphere_nmpc.model.state import Vector, upright_state
from sphere_nmpc.ros import graph_monitor
from sphere_nmpc.ros.cdr import JOINT_NAMES
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_to_ros, stamp_to_ros
from sphere_nmpc.ros.navigator.node import NavigatorNode
from sphere_nmpc.ros.odometry.node import OdometryNode
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan
from sphere_sim.ros.recorder.node import RecorderNode
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.scenario.scenarios import PAPER_CASES

pytestmark = pytest.mark.slow

DOCUMENT = Path(__file__).parents[2] / "docs" / "when_it_does_not_move.md"
ROWS = re.findall(r"^\| ([^|]+?) \|", DOCUMENT.read_text(), re.MULTILINE)
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
CASE = PAPER_CASES[1]


def pattern(words: str) -> re.Pattern[str]:
    """Return the pattern of the log line that the row with these words documents."""
    (row,) = (row for row in ROWS if words in row)
    return re.compile(".*".join(map(re.escape, row.split("…"))))


@pytest.fixture(autouse=True)
def network(monkeypatch) -> None:
    monkeypatch.setattr(graph_monitor, "network_addresses", frozenset)
    monkeypatch.setattr(graph_monitor, "reaches_other_machines", lambda: True)


def robot(
    graph, stamp: Callable[[], float], qos: QoSProfile | int = 10,
    measured: Callable[[int, int], tuple[Vector, int]] = lambda number, now: (CASE.start, now),
) -> None:
    """Publish pose and clock at 50 Hz with stamps [s].

    `measured` returns a pose and its stamp [ns], given its number and the stamp now [ns].
    """
    poses = graph.probe.create_publisher(PoseStamped, "pose", qos)
    clock = graph.probe.create_publisher(Clock, "/clock", 10)
    numbers = count()

    def send() -> None:
        now = round(stamp() * 1e9)
        pose, stamped = measured(next(numbers), now)
        poses.publish(pose_to_ros(pose, stamped, 0.3))
        clock.publish(Clock(clock=stamp_to_ros(now)))

    graph.probe.create_timer(0.02, send)


def forgotten_use_sim_time(graph) -> None:
    graph.start(SimulatorNode)
    graph.start(ControllerNode)


def two_simulators(graph) -> None:
    graph.start(SimulatorNode)
    graph.start(SimulatorNode)
    graph.start(ControllerNode, use_sim_time=True)


def pose_sent_best_effort_in_lockstep(graph) -> None:
    robot(graph, time.time, NEWEST)
    graph.start(ControllerNode, use_sim_time=True, lockstep=True)


def poses_without_a_stamp(graph) -> None:
    robot(graph, time.time, measured=lambda number, now: (CASE.start, 0))
    graph.start(ControllerNode)


def poses_stamped_since_the_start_of_their_driver(graph) -> None:
    poses, start = graph.probe.create_publisher(PoseStamped, "pose", 10), time.monotonic_ns()
    graph.probe.create_timer(0.02, lambda: poses.publish(
        pose_to_ros(CASE.start, 1 + time.monotonic_ns() - start, 0.3)
    ))
    graph.start(ControllerNode)


def turning(number: int) -> Vector:
    """Return a pose that differs from the one before."""
    return upright_state(0.0, 0.0, 1e-3 * number)


def coarse_clock(graph) -> None:
    step = 50_000_000
    robot(graph, time.time, measured=lambda number, now: (turning(number), now // step * step))
    graph.start(ControllerNode)


def bunches_that_are_stamped_when_passed_on(graph) -> None:
    robot(graph, time.time, measured=lambda number, now: (
        turning(number), (now // 200_000_000 - 1) * 200_000_000 + number % 8 * 300_000
    ))
    graph.start(ControllerNode)


def frames_without_the_sphere(graph) -> None:
    robot(graph, time.time, measured=lambda number, now: (
        CASE.goal if number % 20 == 10 else CASE.start, now
    ))
    graph.start(ControllerNode)
    graph.send_goal(CASE.start)


class Slow(Standing):
    """Strategy that takes longer than two periods of 50 Hz."""

    def plan(self, situation: Situation) -> Plan:
        time.sleep(0.05)
        return super().plan(situation)


def map_that_takes_long(graph) -> None:
    robot(graph, time.time)
    changes = graph.start(ControllerNode)._floor_receiver._changes
    make = changes._make

    def slow(given: Any, in_force: Any) -> Any:
        time.sleep(2.0)
        return make(given, in_force)

    changes._make = slow
    sender = graph.probe.create_publisher(PolygonInstanceStamped, "keepout", LATCHED)
    area = PolygonInstanceStamped()
    area.polygon.polygon.points = [Point32(), Point32(x=1.0), Point32(y=1.0)]
    sender.publish(area)


def cache_that_others_can_write(graph) -> None:
    cache_folder().mkdir()
    cache_folder().chmod(0o777)
    graph.start(ControllerNode, goal_memory=30.0)


def rate_beyond_the_machine(graph) -> None:
    robot(graph, time.time)
    node = graph.start(ControllerNode, control_rate=50.0)
    node.controller.planner.strategy = Slow()
    graph.send_goal(CASE.goal)


def lockstep_without_controller(graph) -> None:
    graph.start(SimulatorNode, lockstep=True)


def controller_without_lockstep(graph) -> None:
    node = graph.start(SimulatorNode, **LOCKSTEP)
    graph.start(ControllerNode, use_sim_time=True)
    graph.until(lambda: node._controller_found and node._controllers.free_running)
    node._simulated_clock._timeout = 0.0


def robots_apart(graph) -> None:
    graph.start(SimulatorNode, **{"robot.max_rotor_speed": 60.0})
    graph.start(ControllerNode, use_sim_time=True)


def rolling(graph, **robot: float) -> ControllerNode:
    """Roll a simulated robot with these parameters, that of the controller is the default one."""
    graph.start(SimulatorNode, **{f"robot.{name}": value for name, value in robot.items()})
    controller = graph.start(ControllerNode, use_sim_time=True)
    graph.send_goal(upright_state(1.0, -1.0, 1.57))
    return controller


def robot_given_to_one_node(graph) -> None:
    rolling(graph, shell_radius=0.4)


def velocities_that_are_always_0(graph) -> None:
    controller = rolling(graph).controller
    observe = controller.observe_rotors
    controller.observe_rotors = lambda time, speeds: observe(time, 0.0 * speeds)


def recorder_without_the_namespace(graph) -> None:
    graph.probe.create_publisher(PoseStamped, "/second/pose", 10)
    node = graph.start(RecorderNode, record_on_start=False)
    node._missing._due = 0.0  # told at once


def pose_of_another_type(graph) -> None:
    graph.publisher_apart(PoseWithCovarianceStamped, "pose")
    graph.start(ControllerNode)


def recorded_status_of_another_type(graph) -> None:
    graph.publisher_apart(PoseStamped, "controller/status")
    graph.start(RecorderNode, record_on_start=False)


def readings(graph, stamped: bool, until: float = 1e9) -> None:
    """Send readings of an IMU at 100 Hz, `until` after a wall time [s] from now."""
    sender, end = graph.probe.create_publisher(Imu, "imu", 10), time.monotonic() + until

    def send() -> None:
        if time.monotonic() < end:
            reading = Imu()
            reading.linear_acceleration.z = 9.81
            reading.header.stamp = stamp_to_ros(time.time_ns() if stamped else 0)
            sender.publish(reading)

    graph.probe.create_timer(0.01, send)
    graph.start(OdometryNode)


def readings_without_a_stamp(graph) -> None:
    readings(graph, stamped=False)


def readings_that_end(graph) -> None:
    readings(graph, stamped=True, until=0.5)


def rotor_speeds_that_end(graph) -> None:
    sender, end = graph.probe.create_publisher(JointState, "joint_states", 10), time.monotonic()

    def send() -> None:
        if time.monotonic() < end + 0.5:
            joints = JointState(name=list(JOINT_NAMES), velocity=[0.0, 0.0])
            joints.header.stamp = stamp_to_ros(time.time_ns())
            sender.publish(joints)

    graph.probe.create_timer(0.01, send)
    readings(graph, stamped=True)


def no_imu(graph) -> None:
    graph.start(OdometryNode)


def odometry_without_an_imu(graph) -> None:
    graph.start(OdometryNode)
    graph.start(ControllerNode)


def rotor_speeds_without_a_stamp(graph) -> None:
    sender = graph.probe.create_publisher(JointState, "joint_states", 10)
    speeds = JointState(name=list(JOINT_NAMES), velocity=[0.0, 0.0])
    graph.probe.create_timer(0.01, lambda: sender.publish(speeds))
    graph.start(OdometryNode)


def pose_of_the_simulator_beside(graph) -> None:
    graph.start(SimulatorNode)
    graph.start(OdometryNode, use_sim_time=True)


def two_navigators(graph) -> None:
    navigation_messages.provide()
    graph.start(NavigatorNode)
    graph.probe.create_publisher(GoalStatusArray, "navigate_to_pose/_action/status", LATCHED)


MISTAKES: dict[Callable[..., None], tuple[str, str]] = {
    forgotten_use_sim_time: ("controller", "in simulated time"),
    two_simulators: ("controller", "/clock: given …"),
    pose_sent_best_effort_in_lockstep: ("controller", "incompatible QoS"),
    poses_stamped_since_the_start_of_their_driver: ("controller", "no simulated time"),
    poses_without_a_stamp: ("controller", "no stamp: given poses"),
    pose_of_another_type: ("controller", "other type on"),
    recorded_status_of_another_type: ("recorder", "other type on"),
    coarse_clock: ("controller", "clock that stamps them coarse"),
    bunches_that_are_stamped_when_passed_on: ("controller", "not where bunches of them"),
    frames_without_the_sphere: ("controller", "pose left out"),
    robot_given_to_one_node: ("controller", "other robot"),
    velocities_that_are_always_0: ("controller", "rotor speeds contradicted"),
    map_that_takes_long: ("controller", "floor late"),
    cache_that_others_can_write: ("controller", "goal not kept"),
    rate_beyond_the_machine: ("controller", "missed samples"),
    lockstep_without_controller: ("simulator", "time waits"),
    controller_without_lockstep: ("simulator", "does not run in lockstep"),
    robots_apart: ("simulator", "as in this node"),
    readings_without_a_stamp: ("odometry", "readings of the IMU on …"),
    readings_that_end: ("odometry", "no IMU: given none"),
    no_imu: ("odometry", "no IMU: given no publisher"),
    rotor_speeds_that_end: ("odometry", "cannot be seen; … is published by"),
    pose_of_the_simulator_beside: ("odometry", "the pose jumps between them"),
    odometry_without_an_imu: ("controller", "… reports …"),
    rotor_speeds_without_a_stamp: ("odometry", "no stamp: given rotor speeds"),
    two_navigators: ("navigator", "goals are rejected"),
    recorder_without_the_namespace: ("recorder", "start this node with -r __ns"),
}
"""What a beginner does wrong, which node warns, and words of the row that documents it."""


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.__name__)
def test_mistake_is_logged_once_as_documented(graph, capfd, mistake) -> None:
    source, words = MISTAKES[mistake]
    statuses = graph.collect(DiagnosticStatus, "controller/status")
    mistake(graph)
    printed: list[str] = []

    def warnings() -> list[str]:
        printed.append(capfd.readouterr().err)
        lines = [line for line in "".join(printed).splitlines() if "[WARN]" in line]
        return [line for line in lines if f"[{source}]" in line and pattern(words).search(line)]

    graph.until(warnings)
    graph.spin_for(0.6)
    assert len(warnings()) == 1, "logged once"
    if source == "controller":
        # With its first fault in the message: on a busy machine perhaps another one.
        graph.until(lambda: any(status.level != DiagnosticStatus.OK for status in statuses))
