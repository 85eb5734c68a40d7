# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Frames from live topics, requests to other nodes, and markers, over DDS."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

pytest.importorskip("viser")

from robots import PALM

from sphere_nmpc.model.state import make_state, state_error
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.messages import joint_states_message, pose_to_ros
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.ros.viewer import remote_parameter
from sphere_sim.ros.viewer.markers import MarkerNode
from sphere_sim.ros.viewer.node import TopicSource
from sphere_sim.ros.viewer.remote_parameter import RemoteParameter
from sphere_sim.viewer.frame import Drive
from sphere_sim.viewer.source import ApplyPush, Pause, Reset, SetGoal, SetSpeed, SetStrategy
from sphere_sim.viewer.viewer import Viewer

START = make_state((1.0, 2.0), (1.0, 0.0, 0.0, 0.0))
GOAL = make_state((0.5, 0.0), (0.5, 0.5, 0.5, 0.5))
DRIVE = Drive(0.9, 60.0, 50.0)
ROBOT = {"robot.rotor_axial_inertia": 0.9, "robot.max_rotor_speed": 60.0,
         "robot.max_rotor_acceleration": 50.0}
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def source(graph) -> TopicSource:
    node = Node("viewer")
    graph.add(node)
    return TopicSource(node)


def newest(source):
    return source.frames()[-1]


def notices(graph, source) -> list[str]:
    """Return the notices that arrive next."""
    found: list[str] = []
    graph.until(lambda: found.extend(newest(source).notices) or found)
    return found


def test_viewer_shows_a_running_robot_and_its_requests_are_fulfilled(graph) -> None:
    simulator = SimulatorNode([Parameter("initial_state", value=START.tolist())])
    graph.add(simulator)
    given = {"use_sim_time": True, **ROBOT}
    controller = ControllerNode([Parameter(name, value=value) for name, value in given.items()])
    graph.add(controller)
    graph.publisher(PoseStamped, "goal_pose").publish(pose_to_ros(GOAL, 0, 0.3))
    graph.until(lambda: controller.controller.goal is not None)
    late = Node("viewer")
    graph.add(late)
    source = TopicSource(late)
    graph.until(lambda: newest(source).state is not None and newest(source).goal is not None)
    assert newest(source).radius == pytest.approx(0.3)
    assert state_error(newest(source).goal, GOAL) < 1e-9
    graph.until(lambda: np.all(np.isfinite(newest(source).rotor_speeds)))
    graph.until(lambda: newest(source).strategy != "" and newest(source).alerts == ())
    graph.until(lambda: newest(source).drive == DRIVE)
    assert set(newest(source).capabilities.strategies) == set(STRATEGIES)

    graph.until(lambda: newest(source).capabilities.pause and newest(source).capabilities.push)
    source.handle(Pause(True))
    graph.until(lambda: newest(source).capabilities.paused)
    source.handle(Pause(False))
    graph.until(lambda: not newest(source).capabilities.paused)
    before = simulator.simulator.plant.momentum
    assert source.handle(ApplyPush((0.3, -0.6))) == ""
    graph.until(lambda: simulator.simulator.plant.momentum.any())
    gained = simulator.simulator.plant.momentum - before
    np.testing.assert_allclose(gained, [0.18, 0.09, 0.0], atol=1e-9)
    graph.until(lambda: newest(source).capabilities.speed is not None)
    source.handle(SetSpeed(2.5))
    graph.until(lambda: simulator.get_parameter("real_time_factor").value == 2.5)
    source.handle(SetStrategy("paper"))
    assert newest(source).strategy == "paper", "shown before any status confirms it"
    graph.until(lambda: controller.get_parameter("strategy").value == "paper")
    assert newest(source).capabilities.reset and source.handle(Reset()) == ""


def test_requests_that_cannot_be_fulfilled_are_told(graph, source) -> None:
    frame = newest(source)
    assert frame.state is None and frame.drive == Drive()
    assert frame.alerts == ("no pose yet", "no controller yet")
    assert "goal_pose" in source.handle(SetGoal(GOAL))
    assert "pause" in source.handle(Pause(True))
    can = frame.capabilities
    assert not (can.pause or can.push) and can.speed is None

    def refuse(request, response):
        response.success, response.message = False, "the lid is open"
        return response

    graph.probe.create_service(Trigger, "simulator/reset", refuse)
    graph.until(lambda: newest(source).capabilities.reset)
    source.handle(Reset())
    assert notices(graph, source) == ["the lid is open"] and newest(source).notices == ()

    graph.add(ControllerNode([Parameter("lockstep", value=True)]))
    graph.until(lambda: newest(source).capabilities.strategies)
    source.handle(SetStrategy("paper"))
    assert "lockstep" in notices(graph, source)[0]
    graph.until(lambda: newest(source).strategy == "time_optimal")

    poses = graph.publisher(PoseStamped, "pose")
    poses.publish(pose_to_ros(START, 1, 0.3, "map"))
    graph.until(lambda: "refused" in newest(source).alerts[0])
    assert newest(source).state is None


NOT_OF_A_SIMULATOR = ("fast", float("nan"), [b"\x01"])
NOT_OF_A_CONTROLLER = (
    {"strategy": "<b>"}, {"robot.max_rotor_speed": "100"}, {"robot.rotor_axial_inertia": 1e308}
)
FAR = (float("inf"), 1e300, -1e300, float("nan"))


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_viewer_goes_on_with_messages_and_parameters_that_no_robot_has(
    graph, source, monkeypatch
) -> None:
    monkeypatch.setattr(remote_parameter, "_PERIOD", 1e9)  # requested below only
    viewer = Viewer(source, 0, live=True)
    strange = {name: Node(name, allow_undeclared_parameters=True)
               for name in ("simulator", "controller")}
    for node in strange.values():
        graph.add(node)

    def show() -> None:
        viewer._panel_updated = 0.0
        viewer.tick()
        viewer._plots.show(viewer._history, viewer._frame.drive)

    def taken(parameter, node, values) -> None:
        """Show a frame once the viewer has taken values that the node has now."""
        node.set_parameters([Parameter(name, value=value) for name, value in values.items()])
        answers, take = [], parameter._take_value
        graph.until(parameter._client.services_are_ready)
        with monkeypatch.context() as patch:
            patch.setattr(
                parameter, "_take_value", lambda *about: answers.append(take(*about))
            )
            parameter._polled = -1e9
            graph.until(lambda: source.frames() and answers)
        show()

    try:
        for value in NOT_OF_A_SIMULATOR:
            taken(source._speed, strange["simulator"], {"real_time_factor": value})
            assert newest(source).capabilities.speed is None
        ordinary = {"strategy": "paper", **ROBOT}
        for values in NOT_OF_A_CONTROLLER:
            taken(source._strategy, strange["controller"], {**ordinary, **values})
            assert (newest(source).strategy == "") is ("strategy" in values)
            assert newest(source).drive == (DRIVE if "strategy" in values else Drive())
        taken(source._strategy, strange["controller"], ordinary)
        assert newest(source).drive == DRIVE

        poses = graph.publisher(PoseStamped, "pose")
        joints = graph.publisher(JointState, "joint_states")
        for i in range(16):
            pose = pose_to_ros(START, i, FAR[i % 4])
            pose.pose.position.x, pose.pose.orientation.w = FAR[i % 4], FAR[i // 4 % 4]
            poses.publish(pose)
            joints.publish(joint_states_message(*np.full((3, 2), (1e308, -1e308)[i % 2]), i))
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


class Client:
    """Parameter client whose requests are answered by the test."""

    def __init__(self, *_) -> None:
        self.polls = []

    def services_are_ready(self) -> bool:
        return True

    def get_parameters(self, names, callback) -> None:
        self.polls.append(callback)

    def describe_parameters(self, names, callback) -> None:
        pass

    def set_parameters(self, parameters, callback) -> None:
        pass


def answer(**fields) -> Future:
    future = Future()
    future.set_result(type("Answer", (), fields))
    return future


def test_answer_to_a_poll_before_a_change_does_not_undo_it(monkeypatch) -> None:
    def told(value: str) -> Future:
        return answer(values=[Parameter("strategy", value=value).get_parameter_value()])

    monkeypatch.setattr(remote_parameter, "AsyncParameterClient", Client)
    parameter = RemoteParameter(None, "controller", "strategy", ControllerSettings, print)
    parameter.refresh()
    parameter.set("paper")
    parameter._client.polls[0](told("time_optimal"))
    assert parameter.value == "paper"
    parameter._polled = float("-inf")
    parameter.refresh()
    parameter._client.polls[1](told("plan_keeping"))
    assert parameter.value == "plan_keeping", "what another user has chosen since"
    strange = told("paper")
    strange.result().values[0].type = 99
    parameter._client.polls[1](strange)
    assert parameter.value is None
    choices = "one of: paper, <b>, , paper, time_optimal"
    described = [ParameterDescriptor(additional_constraints=choices)]
    parameter._take_descriptor(answer(descriptors=described))
    assert parameter.choices == ("paper", "time_optimal"), "a list with repetitions breaks a page"


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_markers_are_in_the_size_of_the_robot_and_leave_out_what_no_robot_has(graph) -> None:
    graph.add(MarkerNode())
    received = graph.collect(MarkerArray, "markers")
    poses = graph.publisher(PoseStamped, "pose")
    goals = graph.probe.create_publisher(PoseStamped, "controller/active_goal", LATCHED)
    for i, far in enumerate(FAR):
        goal = pose_to_ros(START, i, 0.3)
        goal.pose.position.x = far
        goals.publish(goal)
        poses.publish(pose_to_ros(START, i, far))  # its height is that of no robot
        graph.until(lambda i=i: len(received) > i)
    assert received[-1].markers[0].scale.x == 0.6
    steps, radius = iter(range(1, 1000)), PALM.shell_radius

    def path_is_drawn() -> bool:
        step = next(steps)
        state = START + 0.2 * radius * step * np.eye(6)[0]
        poses.publish(pose_to_ros(state, step * 10**9, radius))
        seen = len(received)
        graph.until(lambda: len(received) > seen)
        return any(it.ns == "path" and len(it.points) > 2 for it in received[-1].markers)

    graph.until(path_is_drawn)
    markers = {marker.ns: marker for marker in received[-1].markers}
    assert markers["sphere"].scale.x == 2.0 * radius and "goal" not in markers
    assert markers["path"].scale.x == pytest.approx(0.04 * radius)
    assert markers["path"].points[0].z == pytest.approx(0.01 * radius)
    assert markers["gamma"].action == Marker.ADD and len(markers["gamma"].points) > 50
    assert markers["plan"].action == Marker.DELETE
