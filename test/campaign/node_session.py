# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The nodes under test as processes, the relay between them, and all that a fault can use."""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, Vector3
from judge import Judge
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from relay import REMAPPED, Relay
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import QUATERNION, Vector, upright_state
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_nmpc.ros.startup import start_ros
from sphere_sim.ros.session.child_process import parameter_options
from sphere_sim.ros.session.process_set import ProcessSet
from sphere_sim.ros.session.serving import serve_until

READY = 300.0
"""Longest wait for an answer of a node [s, wall]; an idle machine needs two to start it."""
RADIUS = RobotParameters().shell_radius
_SPIN = 4e-3
"""Wall time between two looks at what has arrived [s]."""
_REPEAT = 1.0
"""Wall time after which a goal or request that is not confirmed is sent again [s]: it may be lost,
as a node that was killed stays matched for some time."""
_MATCHED = 30.0
"""Longest wait for a subscriber [s, wall]."""
_SAME = 1e-9
"""Largest difference between the goal sent and the goal confirmed [mixed units]."""
_MOST_PENDING = 10
"""Requests without an answer yet, beyond which a service is not asked again."""
OF_PARAMETERS = {
    "get_parameters": GetParameters, "set_parameters": SetParameters,
    "set_parameters_atomically": SetParametersAtomically, "list_parameters": ListParameters,
    "describe_parameters": DescribeParameters, "get_parameter_types": GetParameterTypes,
}
"""Services that each node has for its parameters."""


class SessionError(SphereNmpcError):
    """A node does not respond as it should, so that the campaign cannot continue."""


class Session:
    """The nodes under test, which end with its context, and all that a fault changes.

    Commands and parameters are those of the nodes by name, logs and bags are in `folder`, and the
    recorder records into a new bag at each start.
    """

    def __init__(
        self, folder: Path, commands: Mapping[str, list[str]],
        parameters: Mapping[str, Mapping[str, object]], judge: Judge,
    ) -> None:
        start_ros([], quiet=True)
        self.folder, self.judge, self.nodes = folder, judge, tuple(commands)
        self._parameters = parameters
        folder.mkdir(parents=True, exist_ok=True)
        self.rng = np.random.default_rng(0)
        """Source of randomness of goals and faults; each trial begins its own."""
        self.services: dict[str, Any] = {
            "simulator/pause": SetBool, "simulator/reset": Trigger, "controller/enable": SetBool,
            "recorder/start": Trigger, "recorder/stop": Trigger,
        }
        """Services of the nodes other than those of parameters."""
        self.processes = ProcessSet(folder)
        for name, command in commands.items():
            self.processes.add(name, command)
        self.node, self._reader = rclpy.create_node("faults"), rclpy.create_node("fault_reader")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.relay = Relay(self.node, self._reader, judge, self.rng)
        self._bags = 0
        self._clients: dict[str, Any] = {}
        self._pending: dict[str, list[Any]] = {}
        self._goals = self.node.create_publisher(PoseStamped, "goal_pose", 1)
        self._pushes = self.node.create_publisher(Vector3, "simulator/push", 10)

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *exception: object) -> None:
        with self.processes:  # which ends them
            pass
        self._executor.shutdown()
        self.node.destroy_node()
        self._reader.destroy_node()
        rclpy.try_shutdown()

    def arguments(self, name: str) -> list[str]:
        """Return the ROS arguments of a node."""
        values = dict(self._parameters[name])
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
            self.processes[name].start(self.arguments(name))

    def wait_for(self, *names: str) -> None:
        """Wait until nodes answer."""
        for name in names:
            self.call(f"{name}/list_parameters", ListParameters.Request())

    def spin(self) -> None:
        """Relay messages and serve this process's own node.

        The timeout is always the same: with another one rclpy's executor begins with the first
        subscription again, and as long as that has messages no other one is served.
        """
        self.relay.forward()
        self.serve_own()
        time.sleep(_SPIN)

    def serve_own(self) -> None:
        """Serve this process's own node once."""
        self._executor.spin_once(timeout_sec=0.0)

    def until(self, condition: Callable[[], object], timeout: float) -> bool:
        """Serve until a condition holds; return False after `timeout` [s, wall]."""
        return serve_until(self.spin, condition, timeout)

    def wait(
        self, condition: Callable[[], object], what: str, timeout: float = READY
    ) -> None:
        """Serve until a condition holds; raise a `SessionError` after `timeout` [s, wall]."""
        if not self.until(condition, timeout):
            raise SessionError(f"timed out after {timeout:g} s while waiting for {what}")

    def ask(self, service: str, request: Any) -> Any:
        """Send a request without waiting; return its future, None if too many are pending."""
        client = self._clients.get(service)
        if client is None:
            kind = OF_PARAMETERS.get(service.partition("/")[2]) or self.services[service]
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
        raise SessionError(
            f"no response of {service}: "
            + (f"none within {READY:g} s" if process.code is None else process.ending)
        )

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

    def try_goal(self, goal: Vector) -> Callable[[], bool]:
        """Return a function that brings a goal, shape (6,), into force, and returns whether it is.

        It has to be called repeatedly.
        """
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

        return is_confirmed

    def push(self, impulse: Vector) -> None:
        """Push the sphere with an impulse, shape (2,) [N s; world frame], once."""
        subscribers = self._pushes.get_subscription_count
        self.wait(lambda: subscribers() > 0, "a subscriber of simulator/push")
        x, y = map(float, impulse)
        self._pushes.publish(Vector3(x=x, y=y))

    @contextmanager
    def publisher(self, kind: type, topic: str, qos: Any = 10) -> Iterator[Any]:
        """Yield a further publisher, which a subscriber is matched with unless that takes long."""
        publisher = self.node.create_publisher(kind, topic, qos)
        try:
            self.until(lambda: publisher.get_subscription_count() > 0, _MATCHED)
            yield publisher
        finally:
            self.node.destroy_publisher(publisher)


def random_goal(
    rng: np.random.Generator, reach: float = 2.0, upright: bool = False
) -> Vector:
    """Return a goal, shape (6,), with |x|, |y| <= `reach` [m] and any heading or orientation."""
    turn = random_quaternion(rng)
    if upright:
        turn = upright_state(0.0, 0.0, rng.uniform(-math.pi, math.pi))[QUATERNION]
    return np.concatenate((rng.uniform(-reach, reach, 2), turn))


def class_of(name: str) -> Any:
    """Return the class of ``package/msg/Name`` or ``package/srv/Name``."""
    package, folder, own = name.split("/")
    return getattr(import_module(f"{package}.{folder}"), own)
