# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""ROS graph of nodes under test and a probe node, all in this process and spun explicitly."""

import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from patience import PATIENCE
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from verb_process import start

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.process.child import Child
from sphere_nmpc.ros.guarded_node import GuardedNode


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by key."""
    return {pair.key: pair.value for pair in status.values}


@contextmanager
def started(verb: str, *options: str) -> Iterator[Child]:
    """Run a node in a process of its own; it must end cleanly."""
    with TemporaryDirectory() as folder:
        node = start(Path(folder), verb, "--ros-args", *options)
        try:
            yield node
            node.send(signal.SIGINT)
            assert node.wait(PATIENCE) == 0, node.output
        finally:
            node.kill()


@contextmanager
def running_graph(args: list[str] | None = None) -> Iterator["Graph"]:
    """Make a graph, which is closed at the end."""
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
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.probe)
        self._nodes: list[Node] = [self.probe]
        self._busy: dict[GuardedNode, SingleThreadedExecutor] = {}
        self._apart: list[Node] = []

    def close(self) -> None:
        for node in self._apart:
            node.destroy_node()
            node.context.try_shutdown()
        for node in self._nodes:
            node.destroy_node()
        for executor in (self._executor, *self._busy.values()):
            executor.shutdown()
        rclpy.try_shutdown()
        assert not self.unforeseen

    def add(self, node: Node) -> None:
        """Spin `node` too, by its own `work` if it has any (the simulator)."""
        if isinstance(node, GuardedNode):
            node._fault_log._period = math.inf  # logged once, however long a busy machine takes
            self._watch(node)
        executor = self._executor
        if isinstance(node, GuardedNode) and type(node).work is not GuardedNode.work:
            # A change of time-out makes an executor forget which callbacks it has found ready and
            # begin again with its first node: in one executor the last nodes might have no turn.
            executor = self._busy[node] = SingleThreadedExecutor()
        executor.add_node(node)
        self._nodes.append(node)

    def start(self, kind: Callable[..., Any], **parameters: object) -> Any:
        """Make a node of a class with parameters, and spin it, too."""
        node = kind([Parameter(name, value=value) for name, value in parameters.items()])
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
        self._busy.pop(node, self._executor).remove_node(node)
        self._nodes.remove(node)
        node.destroy_node()

    def collect(self, kind: type, topic: str, qos: QoSProfile | int = 1000) -> list[Any]:
        """Return a list that fills with what is published on `topic`."""
        messages: list[Any] = []
        self.probe.create_subscription(kind, topic, messages.append, qos)
        return messages

    def publisher(self, kind: type, topic: str) -> Any:
        """Return a publisher that is matched with a subscription."""
        publisher = self.probe.create_publisher(kind, topic, 10)
        self.until(lambda: publisher.get_subscription_count() > 0)
        return publisher

    def publisher_apart(self, kind: type, topic: str, qos: QoSProfile | int = 10) -> Any:
        """Return a publisher in a participant of its own: each knows one type of a topic."""
        context = rclpy.Context()
        rclpy.init(context=context)
        self._apart.append(Node("localiser", context=context))
        return self._apart[-1].create_publisher(kind, topic, qos)

    def call(self, kind: type, name: str, request: Any) -> Any:
        """Return the answer of a service."""
        client = self.probe.create_client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(request)
        self.until(future.done)
        return future.result()

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
        for node, executor in self._busy.items():
            node.work(executor)
        # A simulator publishes several messages an instant, and waits where time stands still; the
        # executor serves one callback a call.
        for _ in range(8 if self._busy else 1):
            self._executor.spin_once(timeout_sec=0.0 if self._busy else 0.01)
