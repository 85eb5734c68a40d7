# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the viewer makes of topics, and what it asks of other nodes, over DDS."""

import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

pytest.importorskip("viser")

from sphere_nmpc.model.state import make_state, state_error
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.conversions import pose_from_ros, pose_to_ros
from sphere_nmpc.settings import STRATEGIES
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.ros.viewer.markers import MarkerNode
from sphere_sim.ros.viewer.topic_source import TopicSource
from sphere_sim.viewer.frame import Pause, Push, Reset, SetGoal, SetSpeed, SetStrategy
from sphere_sim.viewer.health import POSE_SILENCE

START = make_state((1.0, 2.0), (1.0, 0.0, 0.0, 0.0))
GOAL = make_state((0.5, 0.0), (0.5, 0.5, 0.5, 0.5))


@pytest.fixture
def source(graph) -> TopicSource:
    node = Node("viewer")
    graph._nodes.append(node)
    graph._executor.add_node(node)
    return TopicSource(node)


def newest(source):
    return source.frames()[-1]


def simulator(plant: str = "rolling") -> SimulatorNode:
    given = {"initial_state": START.tolist(), "plant": plant}
    return SimulatorNode([Parameter(name, value=value) for name, value in given.items()])


def test_nobody_there_is_told(source) -> None:
    frame = newest(source)
    assert frame.state is None
    assert frame.alerts == ("no pose yet", "no controller yet")
    assert "goal_pose" in source.handle(SetGoal(GOAL))
    assert "pause" in source.handle(Pause(True))
    assert not frame.offers.pause and frame.offers.speed is None


def test_joining_late_shows_pose_goal_and_speeds(graph, source) -> None:
    graph.add(simulator())
    controller = ControllerNode([Parameter("use_sim_time", value=True)])
    graph.add(controller)
    goals = graph.speaker(PoseStamped, "goal_pose")
    goals.publish(pose_to_ros(GOAL, 0, 0.3))
    graph.until(lambda: controller.controller.goal is not None)
    late = Node("late")
    graph._nodes.append(late)
    graph._executor.add_node(late)
    other = TopicSource(late)
    graph.until(lambda: newest(other).state is not None and newest(other).goal is not None)
    frame = newest(other)
    assert frame.radius == pytest.approx(0.3)
    assert state_error(frame.goal, GOAL) < 1e-9
    graph.until(lambda: np.all(np.isfinite(newest(other).rotor_speeds)))
    graph.until(lambda: newest(other).strategy != "" and newest(other).alerts == ())


def test_pause_speed_and_reset_reach_the_simulator(graph, source) -> None:
    node = simulator()
    graph.add(node)
    graph.until(lambda: newest(source).offers.speed is not None and newest(source).offers.pause)
    assert newest(source).offers.reset
    assert not newest(source).offers.push, "the ideal plant cannot be pushed"
    source.handle(Pause(True))
    graph.until(lambda: newest(source).offers.paused)
    source.handle(Pause(False))
    graph.until(lambda: not newest(source).offers.paused)
    source.handle(SetSpeed(2.5))
    graph.until(lambda: node.get_parameter("real_time_factor").value == 2.5)
    assert source.handle(Reset()) == ""


def test_time_that_stands_still_does_so_while_poses_are_late(graph, source) -> None:
    node = simulator()
    graph.add(node)
    graph.until(lambda: newest(source).offers.pause)
    source.handle(Pause(True))
    graph.until(lambda: newest(source).offers.paused)
    time.sleep(2.0 * POSE_SILENCE)  # nobody is served meanwhile
    assert newest(source).offers.paused


def test_a_push_is_offered_where_there_is_one(graph, source) -> None:
    pytest.importorskip("mujoco")
    graph.add(simulator("rigid_body"))
    graph.until(lambda: newest(source).offers.push and newest(source).state is not None)
    at_rest = newest(source).state[0]
    assert source.handle(Push()) == ""
    # Along +x, as push_impulse has it.
    graph.until(lambda: newest(source).state[0] > at_rest + 0.05)


def test_a_request_that_is_refused_is_told_once(graph, source) -> None:
    def refuse(request, response):
        response.success, response.message = False, "the lid is open"
        return response

    graph.probe.create_service(Trigger, "simulator/push", refuse)
    graph.until(lambda: newest(source).offers.push)
    source.handle(Push())
    told: list[str] = []
    graph.until(lambda: told.extend(newest(source).news) or told)
    assert told == ["the lid is open"] and newest(source).news == ()


def test_the_strategy_can_be_chosen(graph, source) -> None:
    node = ControllerNode()
    graph.add(node)
    graph.until(lambda: newest(source).offers.strategies)
    assert set(newest(source).offers.strategies) == set(STRATEGIES)
    source.handle(SetStrategy("paper"))
    assert newest(source).strategy == "paper", "no status tells while time stands still"
    graph.until(lambda: node.get_parameter("strategy").value == "paper")


def test_a_strategy_that_is_refused_is_told_and_the_one_in_force_shown(graph, source) -> None:
    graph.add(ControllerNode([Parameter("lockstep", value=True)]))
    graph.until(lambda: newest(source).offers.strategies)
    source.handle(SetStrategy("paper"))
    told: list[str] = []
    graph.until(lambda: told.extend(newest(source).news) or told)
    assert "lockstep" in told[0]
    graph.until(lambda: newest(source).strategy == "time_optimal")


def test_a_goal_that_is_asked_for_is_published(graph, source) -> None:
    heard = graph.hear(PoseStamped, "goal_pose")
    graph.until(lambda: source._goals.get_subscription_count() > 0)
    assert source.handle(SetGoal(GOAL)) == ""
    graph.until(lambda: heard)
    assert state_error(pose_from_ros(heard[0]), GOAL) < 1e-9


def test_poses_of_another_frame_are_told_and_not_shown(graph, source) -> None:
    poses = graph.speaker(PoseStamped, "pose")
    poses.publish(pose_to_ros(START, 1, 0.3, "map"))
    graph.until(lambda: "refused" in newest(source).alerts[0])
    assert newest(source).state is None


def test_a_sphere_put_elsewhere_begins_anew(graph, source) -> None:
    poses = graph.speaker(PoseStamped, "pose")
    poses.publish(pose_to_ros(START, 1_000_000_000, 0.3))
    graph.until(lambda: newest(source).state is not None)
    poses.publish(pose_to_ros(GOAL, 1_010_000_000, 0.3))
    graph.until(lambda: newest(source).fresh)
    assert not newest(source).fresh


def test_a_controller_that_falls_silent_is_told_within_two_seconds(graph, source) -> None:
    voice = graph.speaker(DiagnosticStatus, "controller/status")
    voice.publish(DiagnosticStatus(name="controller"))
    poses = graph.speaker(PoseStamped, "pose")
    poses.publish(pose_to_ros(START, 1, 0.3))
    graph.until(lambda: newest(source).alerts == ())
    began = time.monotonic()
    graph.until(lambda: newest(source).alerts[:1] and "no pose for" in newest(source).alerts[0])
    assert time.monotonic() - began < 2.0
    graph.until(lambda: "controller silent for" in newest(source).alerts[-1])
    assert time.monotonic() - began < 2.0


def test_markers_are_published_while_somebody_listens(graph) -> None:
    graph.add(MarkerNode())
    graph.speaker(PoseStamped, "pose").publish(pose_to_ros(START, 1, 0.3))
    heard = graph.hear(MarkerArray, "markers")
    graph.until(lambda: heard)
    markers = {marker.ns: marker for marker in heard[-1].markers}
    assert markers["sphere"].scale.x == pytest.approx(0.6)
    assert markers["gamma"].action == Marker.ADD and len(markers["gamma"].points) > 50
    assert markers["plan"].action == Marker.DELETE
