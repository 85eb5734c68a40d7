# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Frames from live topics, requests to other nodes, and markers, over DDS."""

import itertools

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

pytest.importorskip("viser")

from robots import GIANT, PALM

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import make_state, state_error
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.messages import joint_states_message, pose_from_ros, pose_to_ros
from sphere_nmpc.settings import STRATEGIES
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.ros.viewer import remote_parameter
from sphere_sim.ros.viewer.markers import MarkerNode
from sphere_sim.ros.viewer.topic_source import TopicSource
from sphere_sim.viewer.frame import Drive
from sphere_sim.viewer.source import ApplyPush, Pause, Reset, SetGoal, SetSpeed, SetStrategy
from sphere_sim.viewer.viewer import Viewer

START = make_state((1.0, 2.0), (1.0, 0.0, 0.0, 0.0))
GOAL = make_state((0.5, 0.0), (0.5, 0.5, 0.5, 0.5))


@pytest.fixture
def source(graph) -> TopicSource:
    node = Node("viewer")
    graph.add(node)
    return TopicSource(node)


def newest(source):
    return source.frames()[-1]


def simulator() -> SimulatorNode:
    return SimulatorNode([Parameter("initial_state", value=START.tolist())])


def test_missing_nodes_are_reported(source) -> None:
    frame = newest(source)
    assert frame.state is None
    assert frame.alerts == ("no pose yet", "no controller yet")
    assert "goal_pose" in source.handle(SetGoal(GOAL))
    assert "pause" in source.handle(Pause(True))
    assert not frame.capabilities.pause and frame.capabilities.speed is None


def test_late_viewer_shows_pose_goal_and_rotor_speeds(graph, source) -> None:
    graph.add(simulator())
    controller = ControllerNode([Parameter("use_sim_time", value=True)])
    graph.add(controller)
    goals = graph.publisher(PoseStamped, "goal_pose")
    goals.publish(pose_to_ros(GOAL, 0, 0.3))
    graph.until(lambda: controller.controller.goal is not None)
    late = Node("late")
    graph.add(late)
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
    graph.until(lambda: newest(source).capabilities.speed is not None)
    graph.until(lambda: newest(source).capabilities.pause)
    assert newest(source).capabilities.reset
    source.handle(Pause(True))
    graph.until(lambda: newest(source).capabilities.paused)
    source.handle(Pause(False))
    graph.until(lambda: not newest(source).capabilities.paused)
    source.handle(SetSpeed(2.5))
    graph.until(lambda: node.get_parameter("real_time_factor").value == 2.5)
    assert source.handle(Reset()) == ""


def test_push_reaches_the_simulator_with_its_direction(graph, source) -> None:
    assert not newest(source).capabilities.push
    node = simulator()
    graph.add(node)
    graph.until(lambda: newest(source).capabilities.push and newest(source).state is not None)
    at_rest = newest(source).state[:2]
    assert source.handle(ApplyPush((0.3, -0.6))) == ""
    graph.until(lambda: newest(source).state[1] < at_rest[1] - 0.05)
    moved = newest(source).state[:2] - at_rest
    np.testing.assert_allclose(node.simulator.plant.momentum, [0.18, 0.09, 0.0], atol=1e-9)
    assert moved[0] > 0.0


def test_refused_request_gives_one_notice(graph, source) -> None:
    def refuse(request, response):
        response.success, response.message = False, "the lid is open"
        return response

    graph.probe.create_service(Trigger, "simulator/reset", refuse)
    graph.until(lambda: newest(source).capabilities.reset)
    source.handle(Reset())
    notices: list[str] = []
    graph.until(lambda: notices.extend(newest(source).notices) or notices)
    assert notices == ["the lid is open"] and newest(source).notices == ()


def test_drive_is_that_of_the_controller(graph, source) -> None:
    assert newest(source).drive == Drive()
    robot = (("rotor_axial_inertia", 0.9), ("max_rotor_speed", 60.0),
             ("max_rotor_acceleration", 50.0))
    graph.add(ControllerNode([Parameter(f"robot.{name}", value=it) for name, it in robot]))
    graph.until(lambda: newest(source).drive == Drive(0.9, 60.0, 50.0))


NOT_OF_A_SIMULATOR = ("fast", 1e308, float("nan"), -1.0, True, [1.0, 2.0], [b"\x01"])
NOT_OF_A_CONTROLLER = (
    {"strategy": 5}, {"strategy": "<b>"}, {"strategy": ["paper"]},
    {"robot.max_rotor_speed": "100"}, {"robot.rotor_axial_inertia": 1e308},
    {"robot.max_rotor_acceleration": True}, {"robot.max_rotor_speed": 1e-320},
)
FAR = (float("inf"), 1e300, -1e300, float("nan"))


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_viewer_goes_on_with_messages_and_parameters_that_no_robot_has(
    graph, source, monkeypatch
) -> None:
    monkeypatch.setattr(remote_parameter, "_PERIOD", 0.0)
    viewer = Viewer(source, 0, live=True)
    strange = {name: Node(name, allow_undeclared_parameters=True)
               for name in ("simulator", "controller")}
    for node in strange.values():
        graph.add(node)
    node = strange["controller"]

    def show() -> None:
        viewer._panel_updated = 0.0
        viewer.tick()
        viewer._plots.show(viewer._history, viewer._frame.drive)

    def taken(parameter, node, values) -> None:
        """Show frames until the viewer has taken values that the node has now."""
        node.set_parameters([Parameter(name, value=value) for name, value in values.items()])
        answers, take = [], parameter._take_value
        with monkeypatch.context() as patch:
            patch.setattr(
                parameter, "_take_value", lambda *about: answers.append(take(*about))
            )
            graph.until(lambda: show() or len(answers) > 1)  # the first one may be older

    try:
        for value in NOT_OF_A_SIMULATOR:
            taken(source._speed, strange["simulator"], {"real_time_factor": value})
            assert newest(source).capabilities.speed is None
        ordinary = {"strategy": "paper", "robot.rotor_axial_inertia": 0.9,
                    "robot.max_rotor_speed": 60.0, "robot.max_rotor_acceleration": 50.0}
        for values in NOT_OF_A_CONTROLLER:
            taken(source._strategy, node, {**ordinary, **values})
            if "strategy" in values:
                assert newest(source).strategy == ""
            else:
                assert newest(source).drive == Drive()
        taken(source._strategy, node, ordinary)
        assert newest(source).drive == Drive(0.9, 60.0, 50.0)

        poses, joints = graph.publisher(PoseStamped, "pose"), graph.publisher(
            JointState, "joint_states"
        )
        for i in range(40):
            pose = pose_to_ros(START, i, FAR[i % 4])
            poses.publish(pose)
            joints.publish(joint_states_message(*np.full((3, 2), (1e308, -1e308)[i % 2]), i))
            pose.pose.position.x, pose.pose.orientation.w = FAR[i % 4], FAR[i // 4 % 4]
            poses.publish(pose)
            count = source.subscriptions.message_count
            graph.until(lambda count=count: source.subscriptions.message_count > count + 1)
            show()
        assert newest(source).radius == 0.3 and np.isnan(newest(source).rotor_speeds).all()
        poses.publish(pose_to_ros(GOAL, 50, 0.25))
        graph.until(lambda: newest(source).radius == 0.25)
        show()
        assert viewer._scene.radius == 0.25
    finally:
        viewer.close()


def test_strategy_can_be_selected(graph, source) -> None:
    node = ControllerNode()
    graph.add(node)
    graph.until(lambda: newest(source).capabilities.strategies)
    assert set(newest(source).capabilities.strategies) == set(STRATEGIES)
    source.handle(SetStrategy("paper"))
    assert newest(source).strategy == "paper", "shown before any status confirms it"
    graph.until(lambda: node.get_parameter("strategy").value == "paper")


def test_refused_strategy_gives_a_notice_and_the_one_in_force_is_shown(graph, source) -> None:
    graph.add(ControllerNode([Parameter("lockstep", value=True)]))
    graph.until(lambda: newest(source).capabilities.strategies)
    source.handle(SetStrategy("paper"))
    notices: list[str] = []
    graph.until(lambda: notices.extend(newest(source).notices) or notices)
    assert "lockstep" in notices[0]
    graph.until(lambda: newest(source).strategy == "time_optimal")


def test_requested_goal_is_published(graph, source) -> None:
    received = graph.collect(PoseStamped, "goal_pose")
    graph.until(lambda: source._goals.get_subscription_count() > 0)
    assert source.handle(SetGoal(GOAL)) == ""
    graph.until(lambda: received)
    assert state_error(pose_from_ros(received[0]), GOAL) < 1e-9


def test_pose_in_another_frame_is_refused(graph, source) -> None:
    poses = graph.publisher(PoseStamped, "pose")
    poses.publish(pose_to_ros(START, 1, 0.3, "map"))
    graph.until(lambda: "refused" in newest(source).alerts[0])
    assert newest(source).state is None


def test_missing_messages_of_both_nodes_are_reported(graph, source) -> None:
    # The time-outs are tested without a clock, see `LiveFrame`.
    statuses = graph.publisher(DiagnosticStatus, "controller/status")
    poses = graph.publisher(PoseStamped, "pose")

    def alive() -> bool:
        statuses.publish(DiagnosticStatus(name="controller"))
        poses.publish(pose_to_ros(START, 1, 0.3))
        return newest(source).alerts == ()

    graph.until(alive)
    graph.until(lambda: any("no pose for" in it for it in newest(source).alerts))
    graph.until(lambda: any("controller silent for" in it for it in newest(source).alerts))


@pytest.mark.parametrize("robot", [RobotParameters(), PALM, GIANT])
def test_lines_of_the_markers_are_in_the_size_of_the_robot(graph, robot) -> None:
    graph.add(MarkerNode())
    radius = robot.shell_radius
    poses, received = graph.publisher(PoseStamped, "pose"), graph.collect(MarkerArray, "markers")
    steps = itertools.count()

    def path() -> list[Marker]:
        step = next(steps)
        state = START + 0.2 * radius * step * np.eye(6)[0]
        poses.publish(pose_to_ros(state, step, radius))
        found = [it for array in received for it in array.markers if it.ns == "path"]
        return [it for it in found if len(it.points) > 1]

    graph.until(path)
    assert path()[0].scale.x == pytest.approx(0.012 * radius / 0.3)
    assert path()[0].points[0].z == pytest.approx(0.003 * radius / 0.3)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_markers_are_published_to_a_subscriber(graph) -> None:
    graph.add(MarkerNode())
    received = graph.collect(MarkerArray, "markers")
    poses = graph.publisher(PoseStamped, "pose")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    goals = graph.probe.create_publisher(PoseStamped, "controller/active_goal", latched)
    for i, far in enumerate(FAR):
        goal = pose_to_ros(START, i, 0.3)
        goal.pose.position.x = far
        goals.publish(goal)
        poses.publish(pose_to_ros(START, i, far))  # its height is that of no robot
        graph.until(lambda i=i: len(received) > i)
    assert received[-1].markers[0].scale.x == 0.6
    poses.publish(pose_to_ros(START, 1, 0.25))
    graph.until(lambda: received[-1].markers[0].scale.x == 0.5)
    markers = {marker.ns: marker for marker in received[-1].markers}
    assert markers["sphere"].pose.position.x == START[0] and "goal" not in markers
    assert markers["gamma"].action == Marker.ADD and len(markers["gamma"].points) > 50
    assert markers["plan"].action == Marker.DELETE
