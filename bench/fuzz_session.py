# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Session of `fuzz_nodes.py`: the nodes under test, their restoration, and the test of control."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from fuzz_judge import REMAPPED, Judge, Relay, stamped, taken
from fuzz_values import FORGED, example
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, make_state, state_error
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_sim.ros.faults.goal_actions import random_goal
from sphere_sim.ros.session.child_process import parameter_options, verb_command
from sphere_sim.ros.session.process_set import ProcessSet
from sphere_sim.ros.session.serving import serve_until

RATE = 50.0
"""Rate of poses and commands [Hz]."""
NODES: dict[str, dict[str, object]] = {
    "simulator": {"pose_rate": RATE},
    "controller": {"use_sim_time": True, "command_rate": RATE},
    "recorder": {"use_sim_time": True},
    "viewer": {},
    "markers": {"use_sim_time": True},
}
"""Verbs of the nodes, and their parameters."""
READY = 90.0
"""Longest wait for an answer of a node [s, wall]; a busy machine needs some ten to start it."""
PATIENCE = 60.0
"""Wall time after which control counts as lost [s], and likewise that the goal gets nearer."""
_SPIN = 4e-3
_NOTICED = 1.0
"""Wall time until a controller and the judge have noticed what was restored [s]."""
_LATER = NANOSECONDS // 20
"""Time from the newest known one to a pose after a reset; earlier ones may still come [ns]."""
_REPEAT = 1.0
"""Wall time after which a goal or request that is not confirmed is sent again [s]."""
_SAME = 1e-9
"""Largest difference between the goal sent and the goal confirmed [mixed units]."""
_NEAR = 0.1
"""Error below which the sphere is near its goal [mixed units]."""
_FAR = 5.0
"""Distance from the origin beyond which the sphere is put back to its start [m]."""
_RADIUS = RobotParameters().shell_radius
_LONGEST_LINE = 500
"""Characters of a line of a log."""
_QUESTIONS = {
    "get_parameters": GetParameters, "set_parameters": SetParameters,
    "set_parameters_atomically": SetParametersAtomically, "list_parameters": ListParameters,
    "describe_parameters": DescribeParameters, "get_parameter_types": GetParameterTypes,
}
_MOST_PENDING = 10
"""Requests without an answer yet, beyond which a service is not asked again."""
_ACCEPTING = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Fits every subscription."""


class NoAnswerError(SphereNmpcError):
    """A node does not answer a request."""


class Session:
    """The nodes under test, the relay between them, and what a try can use.

    Parameters
    ----------
    folder : Path
        Folder for logs and bags.
    fail : callable
        Takes a complaint: in words that do not change, in detail, and whom it is about.
    """

    def __init__(self, folder: Path, fail: Callable[..., None]) -> None:
        self.fail = fail
        self.alone = True
        """Whether the present try is the only one."""
        self.changed: set[str] = set()
        """What has to be restored after a try: parameters, services, plant."""
        self.expected: set[str] = set()
        """Nodes whose end is wanted."""
        self.topics: dict[str, type] = {}
        """Topics to which a node subscribes, with their types."""
        self.services: dict[str, Any] = {}
        """Services of the nodes other than those of parameters."""
        self.parameters: dict[str, dict[str, ParameterValue]] = {}
        """Parameters of each node, as they were at the beginning."""
        self.most_lines = 0
        """Largest number of lines that a node has logged in a try."""
        self._folder = folder
        self.processes = ProcessSet(folder)
        for name in NODES:
            port = ("--port", "0") if name == "viewer" else ()
            self.processes.add(name, verb_command(name, *port))
        self._examples: dict[str, bytes] = {}
        self._read: Counter[str] = Counter()
        self.node, self._reader = rclpy.create_node("fuzz"), rclpy.create_node("fuzz_reader")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._served: list[Node] = []
        self._clients: dict[str, Any] = {}
        self._pending: dict[str, list[Any]] = {}
        self.judge = Judge(fail)
        self.relay = Relay(self.node, self._reader, self.judge)
        self._goals = self.node.create_publisher(PoseStamped, "goal_pose", 1)

    def start(self, *names: str) -> None:
        """Start nodes and wait until they answer."""
        for name in names:
            values = dict(NODES[name])
            if name == "recorder":
                values["output"] = str(self._folder / f"bag_{time.monotonic_ns()}")
            remapped = [f"{old}:={new}" for old, new in REMAPPED.get(name, {}).items()]
            options = parameter_options(values) + [w for r in remapped for w in ("-r", r)]
            self.processes[name].start(["--ros-args", *options])
        self.expected.difference_update(names)
        if "simulator" in names:
            self.judge.restarted()
            self.relay.shift = max(0, self.relay.shift)  # its time begins at zero
        for name in names:
            self.call(f"{name}/list_parameters", ListParameters.Request())

    def learn(self) -> None:
        """Find parameters, services and topics of the nodes, and an example of each message."""
        for name in NODES:
            names = self.call(f"{name}/list_parameters", ListParameters.Request()).result.names
            self.parameters[name] = dict(zip(names, self._values(name, names), strict=True))
            self.parameters[name].pop("output", None)  # a folder of its own at each start
            for topic, types in self.node.get_subscriber_names_and_types_by_node(name, "/"):
                self.topics[topic] = _class(types[0])
            for service, types in self.node.get_service_names_and_types_by_node(name, "/"):
                if types[0].startswith("std_srvs"):
                    self.services[service.strip("/")] = _class(types[0])
        subscriptions = {
            topic: self._reader.create_subscription(kind, topic, lambda _: None, 10, raw=True)
            for topic, kind in self.topics.items()
        }
        self.until(lambda: False, 3.0)
        for topic, subscription in subscriptions.items():
            found = taken(subscription)
            self._examples[topic] = found[-1][0] if found else example(self.topics[topic])
            self._reader.destroy_subscription(subscription)

    def current_example(self, topic: str) -> bytes:
        """Return a valid message for a topic; stamped with now, if it begins with a stamp."""
        data = self._examples[topic]
        if topic not in ("/clock", "/pose", "/joint_states", "/rotor_trajectory"):
            return data
        return stamped(data, self.judge.now + self.relay.shift)

    @contextmanager
    def publishers(self, topics: Sequence[str]) -> Iterator[dict[str, Any]]:
        """Yield a further publisher for each topic, matched with its subscribers."""
        made = {t: self.node.create_publisher(self.topics[t], t, _ACCEPTING) for t in topics}
        try:
            self.until(lambda: all(p.get_subscription_count() for p in made.values()), 3.0)
            yield made
        finally:
            for publisher in made.values():
                self.node.destroy_publisher(publisher)

    def serve(self, node: Node, wanted: bool = True) -> None:
        """Serve another node of this process, or no longer."""
        (self._executor.add_node if wanted else self._executor.remove_node)(node)
        (self._served.append if wanted else self._served.remove)(node)

    def ask(self, service: str, request: Any) -> Any:
        """Send a request without waiting; return its future, None if too many are pending."""
        client = self._clients.get(service)
        if client is None:
            kind = _QUESTIONS.get(service.partition("/")[2]) or self.services[service]
            client = self._clients[service] = self.node.create_client(kind, service)
        pending = self._pending[service] = [
            future for future in self._pending.get(service, []) if not future.done()
        ]
        if len(pending) >= _MOST_PENDING or not client.service_is_ready():
            return None
        pending.append(client.call_async(request))
        return pending[-1]

    def call(self, service: str, request: Any) -> Any:
        """Return the response of a service; the request is repeated.

        Raises
        ------
        NoAnswerError
            If there is none.
        """
        for stale in self._pending.pop(service, []):
            self._clients[service].remove_pending_request(stale)
        futures: list[Any] = []
        end, due = time.monotonic() + READY, 0.0
        while time.monotonic() < end:
            if time.monotonic() > due:
                due = time.monotonic() + _REPEAT
                futures += filter(None, [self.ask(service, request)])
            self.spin()
            for future in futures:
                if future.done() and future.result() is not None:
                    return future.result()
            if self.processes[service.partition("/")[0]].code is not None:
                break
        raise NoAnswerError(f"no response of {service} within {READY:g} s, or it has ended")

    def spin(self) -> None:
        """Relay messages, serve this process's own nodes and look for nodes that have ended."""
        self.relay.forward()
        if self._served or any(self._pending.values()):
            with suppress(Exception):  # the nodes of this process may be asked anything, too
                self._executor.spin_once(timeout_sec=0.0)
        for process in self.processes:
            if process.code is not None and process.name not in self.expected:
                self.expected.add(process.name)
                lines = [line for line in process.output.splitlines() if line.strip()]
                self.fail("nodes ended", f"{process.ending}: {(lines or [''])[-1]}",
                          process.name)
        time.sleep(_SPIN)

    def until(self, condition: Callable[[], object], timeout: float) -> bool:
        """Serve until a condition holds; return False after `timeout` [s, wall]."""
        return serve_until(self.spin, condition, timeout)

    def restore(self) -> None:
        """Start nodes that have ended, and undo what the tries have changed.

        Raises
        ------
        NoAnswerError
            If a node does not answer.
        """
        changed, judge = self.changed, self.judge
        self.changed = set()
        try:
            self.start(*(name for name in NODES if self.processes[name].code is not None))
            if "parameters" in changed:
                for name in NODES:
                    self._restore_parameters(name)
            if "services" in changed:
                self.call("simulator/pause", SetBool.Request(data=False))
                self.call("controller/enable", SetBool.Request(data=True))
                self.call("recorder/start", Trigger.Request())
            if "plant" in changed or not self._is_near():
                judge.reset_until = math.inf
                self.call("simulator/reset", Trigger.Request())
                done = judge.now + _LATER
                if not self.until(lambda: judge.pose_stamp > done and self._is_near(), READY):
                    raise NoAnswerError(f"no pose of the start within {READY:g} s of a reset")
        finally:
            judge.reset_until = min(judge.reset_until, time.monotonic() + _NOTICED)
            judge.on_system_clock_until = min(
                judge.on_system_clock_until, time.monotonic() + _NOTICED
            )

    def control_back(self, rng: np.random.Generator) -> float | None:
        """Send a goal; return the time until the rotors follow a command to it [s, wall].

        None if they do not, or if the sphere does not get nearer to the goal afterwards.
        """
        began, judge, goal = time.monotonic(), self.judge, self._near_goal(rng)
        due = 0.0

        def confirmed() -> bool:
            nonlocal due
            if judge.goal is not None and np.max(np.abs(judge.goal - goal)) < _SAME:
                return True
            if time.monotonic() > due:
                due = time.monotonic() + _REPEAT
                self._goals.publish(pose_to_ros(goal, 0, _RADIUS))
            return False

        def error() -> float:
            return math.inf if judge.state is None else state_error(judge.state, goal)

        def given_up() -> bool:
            return any(self.processes[name].code is not None for name in NODES)

        came = self.until(
            lambda: given_up() or (confirmed() and judge.follows(began)), PATIENCE
        )
        if given_up():  # which is a complaint already
            return None
        if not came:
            known = "confirmed" if confirmed() else "not confirmed"
            self.fail("control did not come back", f"goal {known}, no rotor follows a command to "
                      f"it within {PATIENCE:g} s, rotors at {judge.turning:.3g} rad/s")
            return None
        took, wanted = time.monotonic() - began, max(0.5 * error(), _NEAR)
        if not self.until(lambda: error() < wanted, PATIENCE):
            self.fail("goals that get no nearer", f"error {error():.3g} after {PATIENCE:g} s")
            return None
        return took

    def check_logs(self) -> None:
        """Complain about what the nodes have logged since the last time."""
        for process in self.processes:
            with process.log.open("rb") as log:
                log.seek(self._read[process.name])
                whole, _, _ = log.read().rpartition(b"\n")
            self._read[process.name] += len(whole) + (1 if whole else 0)
            lines = whole.decode(errors="replace").split("\n")
            self.most_lines = max(self.most_lines, len(lines))
            for line in lines:
                for what in _faults_of(line):
                    self.fail(what, f"{process.name}: {line}", process.name)

    def restart(self) -> None:
        """Start all nodes anew.

        Raises
        ------
        NoAnswerError
            If one of them does not answer.
        """
        self.expected.update(NODES)
        for name in NODES:
            self.processes[name].kill()
        self.start(*NODES)

    def close(self) -> None:
        """Destroy the nodes of this process."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._reader.destroy_node()

    def _is_near(self) -> bool:
        """Return whether the sphere is not too far from the origin."""
        state = self.judge.state
        return state is not None and bool(np.max(np.abs(state[POSITION])) < _FAR)

    def _near_goal(self, rng: np.random.Generator) -> Vector:
        """Return a goal between the origin and the sphere, shape (6,)."""
        place = np.zeros(2) if self.judge.state is None else 0.5 * self.judge.state[POSITION]
        drawn = random_goal(rng, 1.0)
        return make_state(place + drawn[POSITION], drawn[QUATERNION])

    def _values(self, node: str, names: Sequence[str]) -> list[ParameterValue]:
        request = GetParameters.Request(names=list(names))
        return list(self.call(f"{node}/get_parameters", request).values)

    def _restore_parameters(self, node: str) -> None:
        wanted = self.parameters[node]
        for name, value in zip(wanted, self._values(node, list(wanted)), strict=True):
            if value == wanted[name]:
                continue
            parameter = ParameterMessage(name=name, value=wanted[name])
            request = SetParameters.Request(parameters=[parameter])
            (result,) = self.call(f"{node}/set_parameters", request).results
            if not result.successful:
                self.fail("parameters not restored", f"{node} {name}: {result.reason}")


def _class(name: str) -> Any:
    package, _, own = name.partition("/")
    folder, _, kind = own.partition("/")
    return getattr(import_module(f"{package}.{folder}"), kind)


def _faults_of(line: str) -> Iterator[str]:
    """Yield what is wrong with a line of a log."""
    if line.startswith("Traceback (most recent call last)"):
        yield "tracebacks"
    if "RuntimeWarning:" in line and "rclpy" not in line:  # rclpy's are about lost clients
        yield "warnings of libraries in a log"
    if len(line) > _LONGEST_LINE:
        yield "long lines in a log"
    if line.startswith(FORGED):
        yield "forged lines in a log"
    if any(not character.isprintable() and character != "\t" for character in line):
        yield "control characters in a log"
