# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Running nodes under malformed bytes and extreme values on each topic, parameter and service.

Nothing of it ends a node: each still answers, does its work and ends in order, and its log has
short printable lines only.
"""

import random
import signal
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from fuzz_values import FORGED, damaged, example, extreme, extreme_value, parameter_value
from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import Graph
from rosbags.rosbag2 import Reader
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from sphere_nmpc.ros.messages import pose_to_ros
from sphere_sim.ros.session.process_set import ProcessSet
from sphere_sim.scenario.scenarios import PAPER_CASES

pytest.importorskip("viser")

SEED = 26
NODES = ("simulator", "controller", "recorder", "viewer", "markers")
TOPICS = {
    "/clock", "/pose", "/goal_pose", "/joint_states", "/rotor_trajectory", "/rotor_commands",
    "/control_period", "/simulator/push", "/controller/active_goal", "/controller/predicted_path",
    "/controller/status", "/diagnostics",
}
"""Topics that the nodes subscribe to, and further ones of the recorder."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LONGEST_LINE = 700
UNKNOWN_TYPE = 99


def class_of(name: str) -> Any:
    """Return the class of ``package/msg/Name``, ``package/srv/Name`` or ``package/Name``."""
    package, *kind, own = name.split("/")
    return getattr(import_module(f"{package}.{kind[0] if kind else 'msg'}"), own)


def drawn_for(name: str) -> random.Random:
    """Return a source of random values that is the same in each run, in whatever order."""
    return random.Random(f"{SEED} {name}")


def extreme_request(rng: random.Random, kind: Any) -> Any:
    """Return a request of a class with extreme values."""
    request = kind()
    for field, name in kind.get_fields_and_field_types().items():
        setattr(request, field, extreme_value(rng, name))
    return request


class Robot:
    """The nodes of a robot in processes, and a probe in the same graph."""

    def __init__(self, graph: Graph, nodes: ProcessSet) -> None:
        self.graph = graph
        self.nodes = nodes
        self._clients: dict[str, Any] = {}

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Return the answer of a service."""
        client = self._clients.setdefault(name, self.graph.probe.create_client(kind, name))
        self.graph.until(lambda: self.nodes.check() or client.service_is_ready())
        future = client.call_async(request)
        self.graph.until(lambda: self.nodes.check() or future.done())
        return future.result()

    def names(self, node: str) -> list[str]:
        """Return the names of the parameters of a node, which has to answer for that."""
        request = ListParameters.Request(depth=ListParameters.Request.DEPTH_RECURSIVE)
        return self.call(ListParameters, f"{node}/list_parameters", request).result.names

    def set(self, node: str, *parameters: Parameter) -> list[Any]:
        """Return the results of a request to set parameters."""
        request = SetParameters.Request(parameters=list(parameters))
        return self.call(SetParameters, f"{node}/set_parameters", request).results

    def live_parameters(self, node: str) -> list[Parameter]:
        """Return the parameters of a node that may change, with their present values."""
        names = self.names(node)
        kinds, values = (
            self.call(kind, f"{node}/{service}", kind.Request(names=names))
            for kind, service in (
                (DescribeParameters, "describe_parameters"), (GetParameters, "get_parameters")
            )
        )
        return [
            Parameter(name=name, value=value)
            for name, kind, value in zip(names, kinds.descriptors, values.values, strict=True)
            if not kind.read_only
        ]

    def subscribed(self) -> dict[str, Any]:
        """Return class by name of each topic to which a node subscribes."""
        probe = self.graph.probe
        return {
            topic: class_of(types[0])
            for node in NODES
            for topic, types in probe.get_subscriber_names_and_types_by_node(node, "/")
        }

    def services(self) -> dict[str, Any]:
        """Return class by name of each service of a node."""
        probe = self.graph.probe
        return {
            name: class_of(types[0])
            for node in NODES
            for name, types in probe.get_service_names_and_types_by_node(node, "/")
        }


def disturb_topics(robot: Robot) -> None:
    """Send extreme values and damaged bytes on each topic."""
    graph = robot.graph
    graph.until(lambda: robot.subscribed().keys() >= TOPICS)
    for topic, kind in robot.subscribed().items():
        rng, valid = drawn_for(topic), example(kind)
        publisher = graph.probe.create_publisher(kind, topic, LATCHED)
        known = graph.probe.count_subscribers(topic)
        graph.until(lambda p=publisher, n=known: p.get_subscription_count() >= n)
        extremes = [extreme(rng, kind, valid) for _ in range(6)]
        for message in (*extremes, *(damaged(rng, valid) for _ in range(12))):
            with suppress(RuntimeError):  # longer than the middleware can send
                publisher.publish(message)
            graph.spin_for(0.01)  # so that also subscriptions of depth 1 take each of them
            robot.nodes.check()
        graph.probe.destroy_publisher(publisher)
        for node in NODES:
            assert robot.names(node), topic


def disturb_parameters(robot: Robot) -> None:
    """Set each parameter to values of each type; what is refused, is so with a reason."""
    for node in NODES:
        before = robot.live_parameters(node)
        for name in robot.names(node):
            rng = drawn_for(f"{node}/{name}")
            kinds = [ParameterValue(type=kind) for kind in range(10) for _ in range(2)]
            values = [parameter_value(rng, kind) for kind in kinds]
            tried = [Parameter(name=name, value=value) for value in values]
            unknown = Parameter(name=name, value=ParameterValue(type=UNKNOWN_TYPE))
            results = [*robot.set(node, *tried), *robot.set(node, unknown)]
            assert len(results) == len(tried) + 1
            assert all(result.successful or result.reason for result in results), name
            assert not results[-1].successful and str(UNKNOWN_TYPE) in results[-1].reason
        for result in robot.set(node, *before):
            assert result.successful, (node, result.reason)


def disturb_services(robot: Robot) -> None:
    """Request each service with extreme values."""
    for name, kind in robot.services().items():
        rng = drawn_for(name)
        for _ in range(2):
            robot.call(kind, name, extreme_request(rng, kind.Request))


def assert_it_works(robot: Robot) -> None:
    """Check that the robot goes to a goal, is recorded and shown."""
    graph, goal = robot.graph, PAPER_CASES[1].goal
    accepted = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
    poses = graph.collect(PoseStamped, "pose")
    trajectories = graph.collect(JointTrajectory, "rotor_trajectory")
    markers = graph.collect(MarkerArray, "markers")
    for service, on in (("simulator/pause", False), ("controller/enable", True)):
        assert robot.call(SetBool, service, SetBool.Request(data=on)).success
    assert robot.call(Trigger, "simulator/reset", Trigger.Request()).success
    goals = graph.publisher(PoseStamped, "goal_pose")
    goals.publish(pose_to_ros(goal, 0, 0.3))
    graph.until(lambda: accepted and accepted[-1].pose.position.x == goal[0])
    seen, sent = len(poses), len(trajectories)
    graph.until(lambda: len(poses) > seen + 5 and len(trajectories) > sent + 2 and markers)
    robot.call(Trigger, "recorder/stop", Trigger.Request())
    assert robot.call(Trigger, "recorder/start", Trigger.Request()).success


def assert_log_is_short_and_printable(text: str) -> None:
    """Check that no line is long, forged or acts on a terminal."""
    assert "Traceback" not in text
    for line in text.split("\n"):
        assert len(line) < LONGEST_LINE and line.isprintable() and not line.startswith(FORGED)


@pytest.mark.slow
def test_no_message_parameter_or_request_ends_a_node(graph, tmp_path: Path) -> None:
    with ProcessSet(tmp_path) as nodes:
        for node in NODES:
            output = ["-p", f"output:={tmp_path / 'bag'}"] if node == "recorder" else []
            simulated = ["-p", "use_sim_time:=true"] if node != "simulator" else []
            nodes.start(node, ["--ros-args", *simulated, *output])
        robot = Robot(graph, nodes)
        graph.until(lambda: nodes.check() or set(NODES) <= set(graph.probe.get_node_names()))
        disturb_topics(robot)
        disturb_parameters(robot)
        disturb_services(robot)
        assert_it_works(robot)
        for process in nodes:
            process.send(signal.SIGINT)
        codes = {process.name: process.wait(PATIENCE) for process in nodes}
        assert codes == dict.fromkeys(NODES, 0)
        for process in nodes:
            assert_log_is_short_and_printable(process.output)
    bags = sorted(tmp_path.glob("bag*"))
    assert len(bags) > 1
    for bag in bags:
        with Reader(bag) as reader:
            list(reader.messages())
