# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator, controller and recorder as child processes, with the proxy between them."""

import itertools
import os
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Vector3
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.child_command import module_command
from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.startup import start_ros
from sphere_sim.ros.faults.monitor import FaultMonitor
from sphere_sim.ros.faults.proxy import REMAPPED, FaultProxy
from sphere_sim.ros.session.child_process import parameter_options, verb_command
from sphere_sim.ros.session.goal_sender import GoalSender
from sphere_sim.ros.session.process_set import ProcessSet
from sphere_sim.ros.session.serving import serve_until

READY = 60.0
"""How long nodes may take to be ready [s]; a busy machine needs some ten."""
RATE = 20.0
"""Rate of poses, clock and commands [Hz], low enough for the proxy on a busy machine."""
_PRIORITY = 1
"""Real-time priority of controller, simulator and proxy, where the system allows it."""
_SPIN = 5e-3
"""Longest wait of the executor for a message [s]."""
_REPEAT = 3.0
"""Wall time after which an unconfirmed goal or an unanswered request is sent again [s]."""
_RESPONSE_TIMEOUT = 30.0
"""Longest wait for the response of a service [s]."""
_SERVO_ERROR = {"rolling": 0.0, "rigid_body": 0.07}
"""By plant, see `LimitCheck` [rad/s]. A servo of bandwidth b follows a rotor whose axis
accelerates by a with the error a / b. Rotors that ramp at 400 rad/s^2 accelerate the shell by
10 rad/s^2 about their axes, in either direction: 2 * 10 / 300."""
RADIUS = RobotParameters().shell_radius


class SessionError(SphereNmpcError):
    """A node does not respond as it should, so that the campaign cannot continue."""


@dataclass(frozen=True)
class SessionSettings:
    """Settings of a session.

    Attributes
    ----------
    folder : Path
        Folder for logs and bags.
    pace : float
        Simulated over wall time.
    seed : int
        Seed of the goals and of random faults.
    strategy : str
        Strategy of the controller.
    plant : str
        Plant of the simulator.
    rate : float
        Rate of poses, clock and commands, and if it is not the default one, of solves [Hz].
    """

    folder: Path
    pace: float = 2.0
    seed: int = 0
    strategy: str = "time_optimal"
    plant: str = "rolling"
    rate: float = RATE


class FaultSession:
    """The nodes under test, and access to everything that a fault changes.

    Parameters
    ----------
    settings : SessionSettings
        Settings of the session.
    """

    def __init__(self, settings: SessionSettings) -> None:
        self.settings = settings
        self.rng = np.random.default_rng(settings.seed)
        """Source of randomness of goals and faults."""
        settings.folder.mkdir(parents=True, exist_ok=True)
        self._bags = (settings.folder / f"bag_{i}" for i in itertools.count(1))
        self.solver_file = settings.folder / "solver"
        self.processes = ProcessSet(settings.folder)
        fault_controller = module_command("sphere_sim.ros.faults.controller", str(os.getpid()))
        self.processes.add("controller", [*fault_controller, str(self.solver_file)])
        for verb in ("simulator", "recorder"):
            self.processes.add(verb, verb_command(verb))
        self.node = rclpy.create_node("faults")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.monitor = FaultMonitor(self.node, RobotParameters(), _SERVO_ERROR[settings.plant])
        self.proxy = FaultProxy(self.node, self.rng, self.monitor.pose)
        self.goals = GoalSender(self.node, self.spin)
        self._pushes = self.node.create_publisher(Vector3, "simulator/push", 10)
        self._clients = {
            name: self.node.create_client(kind, name)
            for name, kind in (
                ("simulator/pause", SetBool), ("recorder/start", Trigger),
                ("recorder/stop", Trigger), ("recorder/is_recording", Trigger),
                ("simulator/set_parameters", SetParameters),
                ("controller/set_parameters", SetParameters),
            )
        }

    def draw(self, name: str, repetition: int) -> None:
        """Begin the random numbers of a trial, so that they do not depend on others."""
        identity = zlib.crc32(name.encode())
        self.rng = np.random.default_rng([self.settings.seed, identity, repetition])
        self.proxy.stream.rng = self.rng

    def arguments(self, name: str) -> list[str]:
        """Return the ROS arguments of a node."""
        settings = self.settings
        parameters: dict[str, dict[str, object]] = {
            "controller": {
                "use_sim_time": True, "strategy": settings.strategy, "thread_priority": _PRIORITY,
                "command_rate": settings.rate,
                "control_rate": 0.0 if settings.rate == RATE else settings.rate,
            },
            "simulator": {
                "plant": settings.plant, "real_time_factor": settings.pace,
                "pose_rate": settings.rate, "thread_priority": _PRIORITY,
            },
            "recorder": {"use_sim_time": True},
        }
        if name == "recorder":
            parameters[name]["output"] = str(next(self._bags))
        remapped = REMAPPED.get(name, {}).items()
        remappings = [part for old, new in remapped for part in ("-r", f"{old}:={new}")]
        return ["--ros-args", *parameter_options(parameters[name]), *remappings]

    def start(self, name: str) -> None:
        """Start a node, for the first time or again."""
        self.processes[name].start(self.arguments(name))

    def prepare(self) -> None:
        """Start all nodes and wait until they are connected.

        Raises
        ------
        SessionError, GoalNotAcceptedError
            If that takes too long.
        """
        for process in self.processes:
            self.start(process.name)
        self.goals.wait_for_controller(READY)
        for client in self._clients.values():
            self.wait(client.service_is_ready, READY, f"the service {client.srv_name}")
        self.wait(lambda: self.monitor.time > 0.0, READY, "simulated time")
        # Each trial records a bag of its own.
        self.call("recorder/stop", Trigger.Request())
        _schedule_in_real_time()

    def spin(self, duration: float = 0.02) -> None:
        """Serve the campaign's own node for `duration` [s, wall time].

        The timeout is always the same: with another one rclpy's executor begins with the first
        subscription again, and as long as that has messages no other one is served.
        """
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=_SPIN)

    def wait(self, condition: Callable[[], Any], timeout: float, what: str) -> None:
        """Serve the node until a condition holds.

        Raises
        ------
        SessionError
            If that takes too long.
        """
        if not serve_until(self.spin, condition, timeout):
            raise SessionError(f"timed out after {timeout:g} s while waiting for {what}")

    def call(self, service: str, request: Any) -> Any:
        """Call a service, again where there is no response, and return the response.

        As with goals, the request may be lost: a node that was killed stays matched for some
        time. All requests of the campaign may be repeated.

        Raises
        ------
        SessionError
            If there is no response in time.
        """
        client = self._clients[service]
        self.wait(client.service_is_ready, READY, f"the service {service}")
        end = time.monotonic() + _RESPONSE_TIMEOUT
        futures = []
        while time.monotonic() < end:
            futures.append(client.call_async(request))
            if serve_until(self.spin, lambda: any(f.done() for f in futures), _REPEAT):
                return next(future.result() for future in futures if future.done())
        raise SessionError(f"no response of {service} within {_RESPONSE_TIMEOUT:g} s")

    def set_parameters(self, node: str, **values: Any) -> list[Any]:
        """Set parameters of a node and return the result for each."""
        request = SetParameters.Request(
            parameters=[
                Parameter(name.replace("__", "."), value=value).to_parameter_msg()
                for name, value in values.items()
            ]
        )
        return list(self.call(f"{node}/set_parameters", request).results)

    def send_goal(self, goal: Vector) -> None:
        """Bring a goal, shape (6,), into force.

        Raises
        ------
        GoalNotAcceptedError
            If the controller does not confirm it in time.
        """
        self.goals.wait_for_controller(READY)
        self.goals.send(goal, RADIUS, READY, _REPEAT)

    def push(self, impulse: Vector) -> None:
        """Push the sphere with an impulse, shape (2,) [N s; world frame].

        It is sent once only, as it must not be repeated.
        """
        subscribers = self._pushes.get_subscription_count
        self.wait(lambda: subscribers() > 0, READY, "a subscriber of simulator/push")
        x, y = map(float, impulse)
        self._pushes.publish(Vector3(x=x, y=y))

    def close(self) -> None:
        """Destroy the campaign's own node."""
        self._executor.shutdown()
        self.node.destroy_node()


def _schedule_in_real_time() -> None:
    """Give the threads of this process the priority of the nodes, between which it is.

    Where the system does not allow it, nothing changes, as for the nodes.
    """
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK  # not for what is started later
    with suppress(PermissionError):
        for task in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(task.name), policy, os.sched_param(_PRIORITY))


@contextmanager
def fault_session(settings: SessionSettings) -> Iterator[FaultSession]:
    """Yield a session whose nodes are ready; they are ended with the context."""
    start_ros([], quiet=True)
    try:
        session = FaultSession(settings)
        try:
            with session.processes:
                session.prepare()
                yield session
        finally:
            session.close()
    finally:
        rclpy.try_shutdown()
