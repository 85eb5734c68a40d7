# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The nodes under test as processes, the relay between them, and all that a fault can use."""

import math
import os
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from hostile import RADIUS, example
from judge import Judge, Reports
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from relay import REMAPPED, Relay, stamped, taken
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.process.child import module_command
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_nmpc.ros.startup import start_ros
from sphere_sim.ros.session.process_set import ProcessSet, parameter_options, verb_command
from sphere_sim.ros.session.serving import serve_until

READY = 300.0
"""Longest wait for an answer of a node [s, wall]; an idle machine needs two to start it."""
RATE = 20.0
"""Rate of poses, clock and commands [Hz], low enough for the relay on a busy machine."""
SERVO_ERROR = {"rolling": 0.0, "rigid_body": 0.07}
"""By plant, see `LimitCheck` [rad/s]. A servo of bandwidth b follows a rotor whose axis
accelerates by a with the error a / b. Rotors that ramp at 400 rad/s^2 accelerate the shell by
10 rad/s^2 about their axes, in either direction: 2 * 10 / 300."""
_PRIORITY = 1
"""Real-time priority of controller, simulator and relay, where the system allows it."""
_SPIN = 4e-3
"""Wall time between two looks at what has arrived [s]."""
_REPEAT = 1.0
"""Wall time after which a goal or request that is not confirmed is sent again [s]: it may be lost,
as a node that was killed stays matched for some time."""
_MATCHED = 30.0
"""Longest wait for a subscriber [s, wall]."""
_EXAMPLES = 3.0
"""Wall time in which examples of messages are collected [s]."""
_LATER = NANOSECONDS // 20
"""Time from the newest known one to a pose after a reset; earlier ones may still come [ns]."""
_NOTICED = 1.0
"""Wall time until a controller and the judge have noticed what was restored [s]."""
_SAME = 1e-9
"""Largest difference between the goal sent and the goal confirmed [mixed units]."""
_MOST_PENDING = 10
"""Requests without an answer yet, beyond which a service is not asked again."""


class SessionError(SphereNmpcError):
    """A node does not respond as it should, so that the campaign cannot continue."""


@dataclass(frozen=True)
class Settings:
    """What all trials of a campaign have in common."""

    seed: int = 0
    """Seed of the goals and of random faults."""
    rtf: float = 2.0
    """Simulated over wall time."""
    strategy: str = "time_optimal"
    plant: str = "rolling"
    rate: float = RATE
    """Rate of poses, clock and commands, and if it is not the default one, of solves [Hz]."""


class Session:
    """The nodes under test, which end with its context, and all that a fault changes.

    These are simulator, controller with a solver that can fail, and recorder, with `everything`
    also viewer and markers. Logs and bags are in `folder`; the recorder records into a new bag at
    each start.
    """

    def __init__(self, folder: Path, settings: Settings, everything: bool = False) -> None:
        start_ros([], quiet=True)
        self.folder, self.settings, self.everything = folder, settings, everything
        folder.mkdir(parents=True, exist_ok=True)
        self.judge = Judge(SERVO_ERROR[settings.plant])
        self.solver_file = folder.absolute() / "solver"
        control_rate = 0.0 if settings.rate == RATE else settings.rate
        nodes: dict[str, tuple[list[str], dict[str, object]]] = {
            "simulator": (verb_command("simulator"), {
                "plant": settings.plant, "real_time_factor": settings.rtf,
                "pose_rate": settings.rate, "thread_priority": _PRIORITY,
            }),
            "controller": (module_command("bad_strategy", str(self.solver_file)), {
                "use_sim_time": True, "strategy": settings.strategy, "thread_priority": _PRIORITY,
                "command_rate": settings.rate, "control_rate": control_rate,
            }),
            "recorder": (verb_command("recorder"), {"use_sim_time": True}),
        }
        if everything:
            nodes["viewer"] = verb_command("viewer", "--port", "0"), {}
            nodes["markers"] = verb_command("markers"), {"use_sim_time": True}
        self.nodes = tuple(nodes)
        self.processes = ProcessSet(folder)
        self._given = {name: given for name, (_, given) in nodes.items()}
        for name, (command, _) in nodes.items():
            self.processes.add(name, command)
        self.rng = np.random.default_rng(0)
        """Source of randomness of goals and faults; each trial begins its own."""
        self.topics: dict[str, type] = {}
        """With `everything`: topics to which a node subscribes, with their types."""
        self.parameters: dict[str, dict[str, ParameterValue]] = {}
        """With `everything`: parameters of each node, as they were at the beginning."""
        self._examples: dict[str, bytes] = {}
        self.services: dict[str, Any] = {
            "simulator/pause": SetBool, "simulator/reset": Trigger, "controller/enable": SetBool,
            "recorder/start": Trigger, "recorder/stop": Trigger,
            **{f"{node}/{kind}_parameters": service for node in self.nodes for kind, service in (
                ("get", GetParameters), ("set", SetParameters), ("list", ListParameters)
            )},
        }
        """Services of the nodes; all of them with `everything`."""
        self.node, self._reader = rclpy.create_node("faults"), rclpy.create_node("fault_reader")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.relay = Relay(self.node, self._reader, self.judge, self.rng)
        self._bags = 0
        self._clients: dict[str, Any] = {}
        self._pending: dict[str, list[Any]] = {}
        self._goals = self.node.create_publisher(PoseStamped, "goal_pose", 1)
        self.reports = Reports(self.node)

    def __enter__(self) -> "Session":
        """Start all nodes and wait until they work."""
        self.start(*self.nodes)
        self.wait(lambda: self.judge.time > 0.0, "simulated time")
        for name in self.nodes:
            self.call(f"{name}/list_parameters", ListParameters.Request())
        if self.everything:
            self._learn()
        # Each trial records a bag of its own.
        self.call("recorder/stop", Trigger.Request())
        _schedule(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, _PRIORITY)
        return self

    def __exit__(self, *exception: object) -> None:
        _schedule(os.SCHED_OTHER, 0)
        with self.processes:  # which ends them
            pass
        self._executor.shutdown()
        self.node.destroy_node()
        self._reader.destroy_node()
        rclpy.try_shutdown()

    def arguments(self, name: str) -> list[str]:
        """Return the ROS arguments of a node."""
        values = dict(self._given[name])
        if name == "recorder":
            self._bags += 1
            values["output"] = str(self.folder / f"bag_{self._bags}")
        remapped = (f"{old}:={new}" for old, new in REMAPPED.get(name, {}).items())
        options = [part for remapping in remapped for part in ("-r", remapping)]
        return ["--ros-args", *parameter_options(values), *options]

    def start(self, *names: str) -> None:
        """Start nodes, for the first time or again, and do not wait for them."""
        for name in names:
            if name == "simulator":
                self.processes[name].kill()
                self.relay.forward()
                self.judge.restarted()
                self.relay.shift = max(0, self.relay.shift)  # its time begins at zero
            self.processes[name].start(*self.arguments(name))

    def spin(self) -> None:
        """Relay messages and serve this process's own node.

        The timeout is always the same: with another one rclpy's executor begins with the first
        subscription again, and as long as that has messages no other one is served.
        """
        self.relay.forward()
        # A hostile fault asks this node, too.
        with suppress(*([Exception] if self.everything else [])):
            self._executor.spin_once(timeout_sec=0.0)
        time.sleep(_SPIN)

    def until(self, condition: Callable[[], object], timeout: float) -> bool:
        """Serve until a condition holds; return False after `timeout` [s, wall]."""
        return serve_until(self.spin, condition, timeout)

    def wait(self, condition: Callable[[], object], what: str) -> None:
        """Serve until a condition holds; raise a `SessionError` after a long time."""
        if not self.until(condition, READY):
            raise SessionError(f"timed out after {READY:g} s while waiting for {what}")

    def ask(self, service: str, request: Any) -> Any:
        """Send a request without waiting; return its future, None if too many are pending."""
        client = self._clients.get(service)
        if client is None:
            client = self.node.create_client(self.services[service], service)
            self._clients[service] = client
        pending = self._pending[service] = [
            future for future in self._pending.get(service, []) if not future.done()
        ]
        if len(pending) >= _MOST_PENDING or not client.service_is_ready():
            return None
        pending.append(client.call_async(request))
        return pending[-1]

    def call(self, service: str, request: Any) -> Any:
        """Return the response of a service; the request is repeated.

        A `SessionError` is raised if there is none, or the node has ended.
        """
        for stale in self._pending.pop(service, []):
            self._clients[service].remove_pending_request(stale)
        futures: list[Any] = []
        process = self.processes[service.partition("/")[0]]
        end, due = time.monotonic() + READY, 0.0
        while time.monotonic() < end and process.code is None:
            if time.monotonic() > due:
                due = time.monotonic() + _REPEAT
                futures += filter(None, [self.ask(service, request)])
            self.spin()
            for future in futures:
                if future.done() and future.result() is not None:
                    return future.result()
        why = f"none within {READY:g} s" if process.code is None else process.ending
        raise SessionError(f"no response of {service}: {why}")

    def set_parameters(self, node: str, **values: Any) -> list[Any]:
        """Set parameters of a node, a dot in a name given as __; return the result for each."""
        request = SetParameters.Request(parameters=[
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in values.items()
        ])
        return list(self.call(f"{node}/set_parameters", request).results)

    def require_parameters(self, node: str, **values: Any) -> None:
        """Set parameters as `set_parameters`; raise a `SessionError` if one is refused."""
        refused = [r.reason for r in self.set_parameters(node, **values) if not r.successful]
        if refused:
            raise SessionError(f"{node} refused {values}: {refused}")

    def draw(self, name: str, repetition: int) -> None:
        """Begin the random numbers of a trial, so that they do not depend on others."""
        identity = zlib.crc32(name.encode())
        self.rng = np.random.default_rng([self.settings.seed, identity, repetition])
        self.relay.poses.rng = self.rng

    def send_goal(self, goal: Vector) -> None:
        """Bring a goal, shape (6,), into force."""
        due = 0.0
        self.judge.goal = None

        def is_confirmed() -> bool:
            nonlocal due
            given = self.judge.goal
            if given is not None and np.max(np.abs(given - goal)) < _SAME:
                return True
            if time.monotonic() > due and self._goals.get_subscription_count():
                due = time.monotonic() + _REPEAT
                # Without a frame it is in that of the controller; stamp 0 means now.
                self._goals.publish(pose_to_ros(goal, 0, RADIUS, frame=""))
            return False

        self.wait(is_confirmed, "the confirmation of a goal")

    def _learn(self) -> None:
        """Find parameters, services and topics of the nodes, and an example of each message."""
        for name in self.nodes:
            names = self.call(f"{name}/list_parameters", ListParameters.Request()).result.names
            self.parameters[name] = dict(zip(names, self._values(name, names), strict=True))
            self.parameters[name].pop("output", None)  # a folder of its own at each start
            for topic, types in self.node.get_subscriber_names_and_types_by_node(name, "/"):
                self.topics[topic] = class_of(types[0])
            for service, types in self.node.get_service_names_and_types_by_node(name, "/"):
                self.services[service.strip("/")] = class_of(types[0])
        subscriptions = {
            topic: self._reader.create_subscription(kind, topic, lambda _: None, 10, raw=True)
            for topic, kind in self.topics.items()
        }
        self.until(lambda: False, _EXAMPLES)
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

    def _values(self, node: str, names: Sequence[str]) -> list[ParameterValue]:
        request = GetParameters.Request(names=list(names))
        return list(self.call(f"{node}/get_parameters", request).values)

    @contextmanager
    def restored(self) -> Iterator[None]:
        """Allow resets, pushes and other clocks; afterwards undo what was changed."""
        self.judge.lenient_until = math.inf
        try:
            yield
            for node, wanted in self.parameters.items():
                found = zip(wanted, self._values(node, list(wanted)), strict=True)
                changed = [name for name, value in found if value != wanted[name]]
                request = SetParameters.Request(parameters=[
                    ParameterMessage(name=name, value=wanted[name]) for name in changed
                ])
                results = self.call(f"{node}/set_parameters", request).results
                if refused := [result.reason for result in results if not result.successful]:
                    raise SessionError(f"parameters of {node} not restored: {refused}")
            self.without_map()
            self.call("simulator/pause", SetBool.Request(data=False))
            self.call("controller/enable", SetBool.Request(data=True))
            self.call("simulator/reset", Trigger.Request())
            judge, done = self.judge, self.judge.now + _LATER
            self.wait(lambda: judge.pose_stamp > done and judge.state is not None, "a pose")
        finally:
            self.judge.lenient_until = time.monotonic() + _NOTICED

    def without_map(self) -> None:
        """Take away a map that simulator and controller have received."""
        for node in ("simulator", "controller"):
            self.require_parameters(node, map_file="")

    @contextmanager
    def publisher(self, kind: type, topic: str, qos: Any = 10) -> Iterator[Any]:
        """Yield a further publisher, which a subscriber is matched with unless that takes long."""
        publisher = self.node.create_publisher(kind, topic, qos)
        try:
            self.until(lambda: publisher.get_subscription_count() > 0, _MATCHED)
            yield publisher
        finally:
            self.node.destroy_publisher(publisher)


def _schedule(policy: int, priority: int) -> None:
    """Schedule the threads of this process, which is between the nodes, where that is allowed."""
    with suppress(PermissionError):
        for task in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(task.name), policy, os.sched_param(priority))


def class_of(name: str) -> Any:
    """Return the class of ``package/msg/Name`` or ``package/srv/Name``."""
    package, folder, own = name.split("/")
    return getattr(import_module(f"{package}.{folder}"), own)
