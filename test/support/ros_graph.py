# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""ROS graph of nodes under test and a probe node, all in this process and spun explicitly."""

import math
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from patience import PATIENCE
from rcl_interfaces.srv import SetParameters
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from verb_process import start

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.process.child import Child
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_sim.ros.session.process_set import parameter_options


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by key."""
    return {pair.key: pair.value for pair in status.values}


def parameters_of(values: Mapping[str, object]) -> list[Parameter]:
    """Return the parameters with these values."""
    return [Parameter(name, value=value) for name, value in values.items()]


@contextmanager
def started(verb: str, *options: str, **parameters: object) -> Iterator[Child]:
    """Run a node in a process of its own, with ROS arguments; it must end cleanly."""
    with TemporaryDirectory() as folder:
        given = *options, *parameter_options(parameters)
        node = start(Path(folder), verb, "--ros-args", *given)
        try:
            yield node
            node.send(signal.SIGINT)
            assert node.wait(PATIENCE) == 0, node.output
        finally:
            node.kill()


@contextmanager
def started_pair(
    *options: str, simulator: Mapping[str, object], controller: Mapping[str, object],
) -> Iterator[None]:
    """Run simulator and controller with these parameters, and the same ROS arguments."""
    follow = {"use_sim_time": True, "lockstep": simulator.get("lockstep", False)}
    with started("simulator", *options, **simulator), started(
        "controller", *options, **follow, **controller
    ):
        yield


@contextmanager
def running_graph(args: list[str] | None = None) -> Iterator["Graph"]:
    """Make a graph, which is closed at the end; what its nodes store is theirs alone."""
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", folder)
        graph = Graph(args)
        try:
            yield graph
        finally:
            graph.close()


def forget_faults(node: GuardedNode) -> None:
    """Let a node count faults and events from now on, and log each kind once more."""
    for log in (node._fault_log, node._event_log):
        for kept in (log._logged_at, log._suppressed, log._newest, log.counts, log._seen):
            kept.clear()


class Graph:
    """A probe with subscriptions and publishers, and the nodes under test.

    An error of a callback that a node only logs fails the test, unless it takes it from
    `unforeseen`.
    """

    def __init__(self, args: list[str] | None = None) -> None:
        self.unforeseen: list[Exception] = []
        rclpy.init(args=args or [])
        self.probe = Node("probe")
        # Each node has an executor of the kind that it has in a process of its own.
        self._executor, self._plain = EventsExecutor(), SingleThreadedExecutor()
        self._executor.add_node(self.probe)
        self._executor_of: dict[Node, Executor] = {self.probe: self._executor}
        self._busy: list[GuardedNode] = []
        """Nodes with work besides their callbacks."""
        self._apart: list[Node] = []
        self._publishers: dict[tuple[type, str], Any] = {}

    def close(self) -> None:
        for node in self._apart:
            node.destroy_node()
            node.context.try_shutdown()
        for node in self._executor_of:
            node.destroy_node()
        for executor in {self._executor, self._plain, *self._executor_of.values()}:
            executor.shutdown()
        rclpy.try_shutdown()
        assert not self.unforeseen

    def add(self, node: Node) -> None:
        """Spin `node` too, by its own `work` if it has any (the simulator)."""
        executor = self._plain
        if isinstance(node, GuardedNode):
            node._fault_log._period = math.inf  # logged once, however long a busy machine takes
            self._watch(node)
            has_work = type(node).work is not GuardedNode.work
            if node.uses_events_executor:
                executor = self._executor
            elif has_work:
                executor = SingleThreadedExecutor()
            self._busy += [node] * has_work
        self.serve(node, executor)

    def serve(self, node: Node, executor: Executor) -> None:
        """Serve a node by an executor."""
        executor.add_node(node)
        self._executor_of[node] = executor

    def start(self, kind: Callable[..., Any], **parameters: object) -> Any:
        """Make a node of a class with parameters, and spin it, too."""
        node = kind(parameters_of(parameters))
        self.add(node)
        return node

    def _watch(self, node: GuardedNode) -> None:
        logged = node.report

        def report(kind: str, error: Exception) -> None:
            if not isinstance(error, SphereNmpcError):
                self.unforeseen.append(error)
            logged(kind, error)

        node.report = report

    def remove(self, node: Node) -> None:
        """Destroy a node, as when its process ends."""
        self._executor_of.pop(node).remove_node(node)
        self._busy = [one for one in self._busy if one is not node]
        node.destroy_node()

    def collect(self, kind: type, topic: str, qos: QoSProfile | int = 1000) -> list[Any]:
        """Return a list that fills with what is published on `topic`."""
        messages: list[Any] = []
        self.probe.create_subscription(kind, topic, messages.append, qos)
        return messages

    def publisher(self, kind: type, topic: str) -> Any:
        """Return a publisher that is matched with a subscription."""
        if (kind, topic) not in self._publishers:
            self._publishers[kind, topic] = self.probe.create_publisher(kind, topic, 10)
        publisher = self._publishers[kind, topic]
        self.until(lambda: publisher.get_subscription_count() > 0)
        return publisher

    def publisher_apart(self, kind: type, topic: str, qos: QoSProfile | int = 10) -> Any:
        """Return a publisher in a participant of its own: each knows one type of a topic."""
        context = rclpy.Context()
        rclpy.init(context=context)
        self._apart.append(Node("localiser", context=context))
        return self._apart[-1].create_publisher(kind, topic, qos)

    def send(self, topic: str, message: Any) -> None:
        """Publish a message, which a subscription receives."""
        self.publisher(type(message), topic).publish(message)

    def send_goal(self, goal: Vector, stamp: int = 0, topic: str = "goal_pose") -> None:
        self.send(topic, pose_to_ros(goal, stamp, 0.3))

    def ask(self, kind: Any, name: str, **fields: Any) -> Any:
        """Return the future of the answer of a service."""
        client = self.probe.create_client(kind, name)
        self.until(client.service_is_ready)
        return client.call_async(kind.Request(**fields))

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        """Return the answer of a service."""
        future = self.ask(kind, name, **fields)
        self.until(future.done)
        return future.result()

    def set_parameters(self, node: str, **values: object) -> list[Any]:
        """Return the answer for each parameter of a node that is set by its service."""
        given = [parameter.to_parameter_msg() for parameter in parameters_of(values)]
        return self.call(SetParameters, f"{node}/set_parameters", parameters=given).results

    def until(self, condition: Callable[[], Any]) -> None:
        """Spin until `condition` holds; fail after `PATIENCE` of wall time."""
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, "time-out"
            self.spin()

    def spin_for(self, duration: float) -> None:
        """Spin for a wall time [s] in which something must not happen."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self.spin()

    def spin(self) -> None:
        for node in self._busy:
            node.work(self._executor_of[node])
        # The executors serve one callback a call, but there are several messages an instant.
        for turn in range(8):
            self._executor.spin_once(timeout_sec=0.0 if self._busy or turn else 0.01)
            if self._plain.get_nodes():
                self._plain.spin_once(timeout_sec=0.0)
