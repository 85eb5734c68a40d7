# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Each mistake of a beginner is logged once, with cause and remedy, as documented."""

import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Vector3
from patience import LOCKSTEP
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from standing import Standing
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.ros import graph_monitor
from sphere_nmpc.ros.controller import monitor
from sphere_nmpc.ros.controller import node as controller_node
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.messages import pose_to_ros, stamp_to_ros, trajectory_message
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_sim.ros.recorder.node import RecorderNode
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.scenario.scenarios import PAPER_CASES

DOCUMENT = Path(__file__).parents[3] / "docs" / "when_it_does_not_move.md"
ROWS = [
    row.strip() for row in re.findall(r"^\| ([^|]+?) \|", DOCUMENT.read_text(), re.MULTILINE)
    if row.strip() != "the log says"
]
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
CASE = PAPER_CASES[1]
ADDRESSES: set[str] = set()
"""Addresses of this machine in its network, as the nodes under test see them."""


@pytest.fixture(autouse=True)
def network(monkeypatch) -> None:
    ADDRESSES.clear()
    monkeypatch.setattr(graph_monitor, "network_addresses", lambda: frozenset(ADDRESSES))
    monkeypatch.setattr(graph_monitor, "reaches_other_machines", lambda: True)


def pattern(row: str) -> re.Pattern[str]:
    """Return the pattern of a log line documented by a row."""
    return re.compile(".*".join(map(re.escape, row.split("…"))))


def controller(graph, **parameters) -> ControllerNode:
    node = ControllerNode([Parameter(name, value=value) for name, value in parameters.items()])
    graph.add(node)
    return node


def simulator(graph, **parameters) -> SimulatorNode:
    node = SimulatorNode([Parameter(name, value=value) for name, value in parameters.items()])
    graph.add(node)
    return node


def robot(graph, pose: Callable[[float], float | None], clock: Callable[[float], float | None],
          qos: QoSProfile | int = 10, frame: str = "world") -> None:
    """Publish pose and clock at 50 Hz; both get the wall time since now [s] and return a stamp.

    None is nothing that is sent; a topic on which nothing is ever sent has no publisher.
    """
    began = time.monotonic()
    ends = [(kind, topic, when, graph.probe.create_publisher(kind, topic, quality))
            for kind, topic, when, quality in (
                (PoseStamped, "pose", pose, qos), (Clock, "/clock", clock, 10))
            if when is not silent]

    def send() -> None:
        for kind, _, when, publisher in ends:
            seconds = when(time.monotonic() - began)
            if seconds is None:
                continue
            stamp = round(seconds * 1e9)
            message = Clock(clock=stamp_to_ros(stamp))
            if kind is PoseStamped:
                message = pose_to_ros(CASE.start, stamp, 0.3, frame)
            publisher.publish(message)

    graph.probe.create_timer(0.02, send)


def silent(_: float) -> None:
    """Stamp of a topic without a publisher."""


def published_but_silent(_: float) -> None:
    """Stamp of a topic with a publisher that sends nothing."""


def running(elapsed: float) -> float:
    return 1.0 + elapsed


def at_first(elapsed: float) -> float | None:
    return 1.0 + elapsed if elapsed < 1.5 else None


def on_the_wall(_: float) -> float:
    return time.time()


def forgotten_use_sim_time(graph) -> None:
    simulator(graph)
    controller(graph)


def no_simulator(graph) -> None:
    controller(graph, use_sim_time=True)


def clock_of_another(graph) -> None:
    graph.probe.create_publisher(Clock, "/second/clock", 10)
    controller(graph, use_sim_time=True)


def silent_clock(graph) -> None:
    robot(graph, silent, published_but_silent)
    controller(graph, use_sim_time=True)


def stopped_simulator(graph) -> None:
    robot(graph, at_first, at_first)
    controller(graph, use_sim_time=True)


def clock_held_back(graph) -> None:
    robot(graph, running, at_first)
    controller(graph, use_sim_time=True)


def clock_that_is_set(graph) -> None:
    def forth_and_back(elapsed: float) -> float:
        return running(elapsed) + (3600.0 if elapsed % 2.0 > 1.9 else 0.0)

    robot(graph, running, forth_and_back)
    controller(graph, use_sim_time=True)


def needless_use_sim_time(graph) -> None:
    robot(graph, on_the_wall, running)
    controller(graph, use_sim_time=True)


def clocks_apart(graph) -> None:
    robot(graph, lambda _: time.time() - 5.0, silent)
    controller(graph)


def clock_ahead(graph) -> None:
    robot(graph, lambda _: time.time() + 5.0, silent)
    controller(graph)


def no_pose(graph) -> None:
    controller(graph)


def silent_pose(graph) -> None:
    robot(graph, published_but_silent, silent)
    controller(graph)


def two_simulators(graph) -> None:
    simulator(graph)
    simulator(graph)
    controller(graph, use_sim_time=True)


def two_poses(graph) -> None:
    robot(graph, on_the_wall, silent)
    robot(graph, on_the_wall, silent)
    controller(graph)


def two_controllers(graph) -> None:
    robot(graph, on_the_wall, silent)
    graph.probe.create_publisher(JointTrajectory, "rotor_trajectory", 10)
    controller(graph)


def pose_sent_best_effort_in_lockstep(graph) -> None:
    robot(graph, running, running, NEWEST)
    controller(graph, use_sim_time=True, lockstep=True)


def carried_sphere(graph) -> None:
    def send() -> None:
        shift = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]) * (time.time() % 1.0 > 0.5)
        sender.publish(pose_to_ros(CASE.start + shift, time.time_ns(), 0.3))

    sender = graph.probe.create_publisher(PoseStamped, "pose", 10)
    graph.probe.create_timer(0.02, send)
    controller(graph)


def pose_in_another_frame(graph) -> None:
    robot(graph, on_the_wall, silent, frame="map")
    controller(graph)


def goal_in_another_frame(graph) -> None:
    robot(graph, on_the_wall, silent)
    controller(graph)
    goal = pose_to_ros(CASE.goal, 0, 0.3, "map")
    graph.publisher(PoseStamped, "goal_pose").publish(goal)


def clock_before_zero(graph) -> None:
    robot(graph, silent, lambda _: -5.0)
    controller(graph, use_sim_time=True)


def damaged_goal(graph) -> None:
    robot(graph, on_the_wall, silent)
    controller(graph)
    graph.publisher(PoseStamped, "goal_pose").publish(b"\x00\x01\x00\x00")


def network_after_the_start(graph) -> None:
    ADDRESSES.clear()
    robot(graph, on_the_wall, silent)
    controller(graph)
    ADDRESSES.add("192.0.2.1")


def standing(graph, strategy: Standing) -> None:
    """Make a strategy stand still in front of a goal, in time that runs five times as fast."""
    def hurried(elapsed: float) -> float:
        return 1.0 + 5.0 * elapsed

    robot(graph, hurried, hurried)
    node = controller(graph, use_sim_time=True, strategy="paper")
    node.controller._strategy = strategy
    graph.publisher(PoseStamped, "goal_pose").publish(pose_to_ros(CASE.goal, 0, 0.3))


def stationary_point(graph) -> None:
    standing(graph, Standing(message="converged"))


def plan_that_is_not_found(graph) -> None:
    standing(graph, Standing(status=PlanStatus.RAMP_TO_REST, message="no arrival found yet"))


def blocked_sphere(graph) -> None:
    standing(graph, Standing(speed=50.0))


def goal_that_cannot_be_held(graph) -> None:
    standing(graph, Standing(status=PlanStatus.HOLDING, given_up="orientation by 30.0 deg: …"))


def plans_that_begin_later(graph) -> None:
    standing(graph, Later())


def rate_beyond_the_machine(graph) -> None:
    robot(graph, on_the_wall, silent)
    node = controller(graph, control_rate=50.0)
    node.controller._strategy = Slow()
    graph.publisher(PoseStamped, "goal_pose").publish(pose_to_ros(CASE.goal, 0, 0.3))


class Slow(Standing):
    """Strategy that takes longer than two periods of 50 Hz."""

    def plan(self, situation: Situation) -> Plan:
        time.sleep(0.05)
        return super().plan(situation)


def slope(graph) -> None:
    start = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    simulator(graph, initial_state=start, slope=0.01, real_time_factor=5.0)
    controller(graph, use_sim_time=True, strategy="plan_keeping")
    graph.publisher(PoseStamped, "goal_pose").publish(pose_to_ros(np.array(start), 0, 0.3))


def slope_for_too_long(graph) -> None:
    slope(graph)


class Later(Standing):
    """Strategy whose plans all begin with a rest."""

    def plan(self, situation: Situation) -> Plan:
        times = situation.time + np.array([0.0, 2.0, 2.5])
        speeds = np.array([[0.0, 0.0], [0.0, 0.0], [50.0, 0.0]])
        return replace(super().plan(situation), hold=FirstOrderHold(times, speeds))


def lockstep_without_controller(graph) -> None:
    simulator(graph, lockstep=True)


def ended_controller_in_lockstep(graph) -> None:
    node = simulator(graph, **LOCKSTEP)
    sender = graph.probe.create_publisher(JointTrajectory, "rotor_trajectory", 10)
    graph.until(lambda: node._controller_found)
    graph.probe.destroy_publisher(sender)
    waits_no_longer(node)


def waits_no_longer(node: SimulatorNode) -> None:
    """Let the time-out pass now that the cause is there."""
    node._simulated_clock._timeout = 0.0


def controller_without_lockstep(graph) -> None:
    node = simulator(graph, **LOCKSTEP)
    controller(graph, use_sim_time=True)
    graph.until(lambda: node._controller_found and node._limits.free_running)
    waits_no_longer(node)


def controller_in_lockstep_without_poses(graph) -> None:
    node = simulator(graph, **LOCKSTEP)
    awaited = controller(graph, use_sim_time=True, lockstep=True)
    awaited.destroy_subscription(awaited._inputs[0])
    graph.until(lambda: node._controller_found and node._awaited._message)
    waits_no_longer(node)


def controller_that_hangs_in_lockstep(graph) -> None:
    node = simulator(graph, **LOCKSTEP)
    graph.publisher(JointTrajectory, "rotor_trajectory")
    graph.until(lambda: node._controller_found)
    waits_no_longer(node)


def commands_on_another_clock(graph) -> None:
    simulator(graph)
    sender = graph.publisher(JointTrajectory, "rotor_trajectory")
    hold = FirstOrderHold.ramp_to_rest(0.0, CASE.start[:2] + 1.0, 400.0)
    sender.publish(trajectory_message(hold, time.time_ns()))


def drives_too_weak(graph) -> None:
    simulator(graph, plant="rigid_body", **{"rigid_body.torque_limit": 1.6})


def robots_apart(graph) -> None:
    simulator(graph, **{"robot.max_rotor_speed": 60.0})
    controller(graph, use_sim_time=True)


def torque_left_out_in_the_controller(graph) -> None:
    weak = {"rigid_body.torque_limit": 1.6, "robot.max_rotor_torque": 1.6}
    simulator(graph, plant="rigid_body", **weak)
    controller(graph, use_sim_time=True)


def recorder(graph) -> None:
    node = RecorderNode([Parameter("record_on_start", value=False)])
    graph.add(node)
    node._missing._due = 0.0  # told at once


def recorder_without_the_namespace(graph) -> None:
    graph.probe.create_publisher(PoseStamped, "/second/pose", 10)
    recorder(graph)


def recorder_without_a_robot(graph) -> None:
    recorder(graph)


def push_from_above(graph) -> None:
    simulator(graph)
    graph.publisher(Vector3, "simulator/push").publish(Vector3(z=-1.0))


MISTAKES: dict[Callable[..., None], str] = {
    forgotten_use_sim_time: "in simulated time",
    no_simulator: "expected one; start a simulator",
    clock_of_another: "follows the clock that is there",
    silent_clock: "that has sent nothing",
    stopped_simulator: "expected a running simulator",
    clock_held_back: "poses but no message",
    clock_that_is_set: "clock jumped",
    needless_use_sim_time: "on the system clock",
    clocks_apart: "synchronise the clocks of the machines",
    clock_ahead: "are the clocks synchronised",
    no_pose: "no publisher of … for",
    silent_pose: "but none of its messages",
    two_simulators: "/clock: given …",
    two_poses: "/pose: given …",
    two_controllers: "/rotor_trajectory: given …",
    pose_sent_best_effort_in_lockstep: "incompatible QoS",
    carried_sphere: "pose jumped",
    pose_in_another_frame: ": pose refused: frame",
    goal_in_another_frame: ": goal_pose refused: frame",
    clock_before_zero: "/clock refused",
    damaged_goal: "a message of this type",
    network_after_the_start: "expected the one that this node announces",
    stationary_point: "the plan leaves it where it is",
    plan_that_is_not_found: "there is no plan",
    blocked_sphere: "is it blocked",
    goal_that_cannot_be_held: "the strategy gives up",
    plans_that_begin_later: "moves it later",
    slope: "rotors near their limit",
    slope_for_too_long: "rotors at their limit",
    rate_beyond_the_machine: "missed samples",
    lockstep_without_controller: "time waits",
    ended_controller_in_lockstep: "its sender has ended",
    controller_without_lockstep: "does not run in lockstep",
    controller_in_lockstep_without_poses: "the controller is there and reports",
    controller_that_hangs_in_lockstep: "no status of the controller either",
    commands_on_another_clock: "rotor_trajectory refused",
    drives_too_weak: "limits: rigid_body.torque_limit",
    robots_apart: "as in this node",
    torque_left_out_in_the_controller: "for rigid_body.torque_limit",
    push_from_above: "push refused",
    recorder_without_the_namespace: "start this node with -r __ns",
    recorder_without_a_robot: "or name its namespace",
}
"""What a beginner does wrong, and words of the row that documents its warning."""
OF_THE_SIMULATOR = (
    lockstep_without_controller, ended_controller_in_lockstep, controller_without_lockstep,
    controller_in_lockstep_without_poses, controller_that_hangs_in_lockstep,
    commands_on_another_clock, drives_too_weak, robots_apart, torque_left_out_in_the_controller,
    push_from_above,
)
OF_THE_RECORDER = (recorder_without_the_namespace, recorder_without_a_robot)


def row_of(words: str) -> str:
    (row,) = (row for row in ROWS if words in f": {row}")
    return row


def test_every_row_of_the_document_is_a_mistake_that_is_made_here() -> None:
    assert sorted(map(row_of, MISTAKES.values())) == sorted(ROWS)


def test_faults_are_logged_within_two_seconds() -> None:
    slack = 2.0 - monitor.SILENCE_LIMIT - 2.0 * controller_node._CHECK_EVERY
    assert slack > 0.2


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.__name__)
def test_mistake_is_logged_once_as_documented(graph, capfd, mistake) -> None:
    row = row_of(MISTAKES[mistake])
    statuses = graph.collect(DiagnosticStatus, "controller/status")
    mistake(graph)
    printed: list[str] = []

    def warnings() -> list[str]:
        printed.append(capfd.readouterr().err)
        lines = [line for line in "".join(printed).splitlines() if "[WARN]" in line]
        return [line for line in lines if f"[{source}]" in line and pattern(row).search(line)]

    source = "controller"
    for name, mistakes in (("simulator", OF_THE_SIMULATOR), ("recorder", OF_THE_RECORDER)):
        source = name if mistake in mistakes else source
    graph.until(warnings)
    graph.spin_for(0.6)
    assert len(warnings()) == 1, "logged once"
    if source == "controller" and not any(word in row for word in ("refused", "pose jumped")):
        graph.until(lambda: any(pattern(row).search(status.message) for status in statuses))
        assert all(
            status.level != DiagnosticStatus.OK
            for status in statuses if pattern(row).search(status.message)
        )


def test_end_of_a_fault_is_logged(graph, capfd) -> None:
    robot(graph, lambda elapsed: time.time() if elapsed > 2.5 else None, silent)
    controller(graph)
    printed: list[str] = []

    def heard(words: str) -> bool:
        printed.append(capfd.readouterr().err)
        return words in "".join(printed)

    graph.until(lambda: heard("no pose: given a publisher"))
    graph.until(lambda: heard("no pose: over"))
