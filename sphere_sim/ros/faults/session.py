# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator, controller and recorder in processes of their own, with the proxy between them."""

import contextlib
import itertools
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.startup import start_ros
from sphere_sim.ros.faults.monitor import FaultMonitor
from sphere_sim.ros.faults.proxy import REMAPPED, FaultProxy
from sphere_sim.ros.session.goal_sender import GoalNotAcceptedError, GoalSender
from sphere_sim.ros.session.processes import NodeProcess, stop_together

READY = 60.0
"""How long nodes may take to come up [s]; a busy machine needs some ten."""
_RATE = 20.0
"""Rate of poses, clock and commands [Hz]: the proxy has to pass them on, on a busy machine too."""
_REPEAT = 3.0
"""Wall time after which an unconfirmed goal or an unanswered request is sent again [s]."""
_ANSWER = 30.0
"""How long a service may take to answer [s]."""
RADIUS = RobotParameters().shell_radius


class SessionError(SphereNmpcError):
    """The nodes do not do what the campaign needs of them."""


@dataclass(frozen=True)
class SessionSettings:
    """How a session runs.

    Attributes
    ----------
    folder : Path
        For logs and bags.
    pace : float
        Simulated over wall time.
    seed : int
        Of goals and of chance in the faults.
    strategy : str
        What the controller solves.
    """

    folder: Path
    pace: float = 2.0
    seed: int = 0
    strategy: str = "time_optimal"


class FaultSession:
    """The nodes on trial, and everything the campaign can do to them.

    Parameters
    ----------
    settings : SessionSettings
        How it runs.
    """

    def __init__(self, settings: SessionSettings) -> None:
        self.settings = settings
        self.rng = np.random.default_rng([settings.seed, 0])
        settings.folder.mkdir(parents=True, exist_ok=True)
        self._bags = (settings.folder / f"bag_{i}" for i in itertools.count(1))
        self.solver_file = settings.folder / "solver"
        self.processes = {
            name: NodeProcess(name, self._command(name), settings.folder)
            for name in ("controller", "simulator", "recorder")
        }
        self.node = rclpy.create_node("faults")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.monitor = FaultMonitor(self.node, RobotParameters())
        self.proxy = FaultProxy(self.node, self.rng, self.monitor.pose)
        self.goals = GoalSender(self.node, self.spin)
        self._clients = {
            name: self.node.create_client(kind, name)
            for name, kind in (
                ("simulator/pause", SetBool), ("recorder/start", Trigger),
                ("recorder/stop", Trigger), ("recorder/is_recording", Trigger),
                ("simulator/set_parameters", SetParameters),
                ("controller/set_parameters", SetParameters),
            )
        }

    def _command(self, name: str) -> list[str]:
        parent = str(os.getpid())
        if name == "controller":
            return ["sphere_sim.ros.faults.controller", parent, str(self.solver_file)]
        return ["sphere_sim.cli.child", parent, name]

    def arguments(self, name: str) -> list[str]:
        """Return the ROS arguments of a node."""
        parameters: dict[str, dict[str, object]] = {
            "controller": {
                "use_sim_time": True, "command_rate": _RATE, "strategy": self.settings.strategy,
                "thread_priority": 1,
            },
            "simulator": {
                "real_time_factor": self.settings.pace, "pose_rate": _RATE, "thread_priority": 1,
            },
            "recorder": {"use_sim_time": True},
        }
        if name == "recorder":
            parameters[name]["output"] = str(next(self._bags))
        given = [f"{key}:={_text(value)}" for key, value in parameters[name].items()]
        remapped = [f"{old}:={new}" for old, new in REMAPPED.get(name, {}).items()]
        return ["--ros-args", *_each("-p", given), *_each("-r", remapped)]

    def start(self, name: str) -> None:
        """Start a node, again perhaps."""
        self.processes[name].start(self.arguments(name))

    def prepare(self) -> None:
        """Start all nodes and wait until they hear each other.

        Raises
        ------
        SessionError, GoalNotAcceptedError
            If that takes too long.
        """
        for name in self.processes:
            self.start(name)
        self.goals.wait_for_controller(READY)
        for client in self._clients.values():
            self.wait(client.service_is_ready, READY, f"the service {client.srv_name}")
        self.wait(lambda: self.monitor.time > 0.0, READY, "simulated time")
        # Each trial has a bag of its own.
        self.ask("recorder/stop", Trigger.Request())

    def spin(self, duration: float = 0.02) -> None:
        """Serve the campaign's own node for some wall time [s]."""
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def wait(self, condition: Callable[[], Any], timeout: float, what: str) -> None:
        """Serve the node until a condition holds.

        Raises
        ------
        SessionError
            If that takes too long.
        """
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                raise SessionError(f"waited {timeout:g} s in vain for {what}")
            self.spin()

    def ask(self, service: str, request: Any) -> Any:
        """Return the answer of a service, which is asked again where it does not answer.

        As with goals: a request to a node that was killed goes to nobody. All that is asked for
        here may be asked for twice.

        Raises
        ------
        SessionError
            If there is none in time.
        """
        client = self._clients[service]
        self.wait(client.service_is_ready, READY, f"the service {service}")
        end = time.monotonic() + _ANSWER
        futures = []
        while time.monotonic() < end:
            futures.append(client.call_async(request))
            with contextlib.suppress(SessionError):
                self.wait(lambda: any(f.done() for f in futures), _REPEAT, "an answer")
                return next(future.result() for future in futures if future.done())
        raise SessionError(f"waited {_ANSWER:g} s in vain for an answer of {service}")

    def set_parameters(self, node: str, **values: Any) -> list[Any]:
        """Set parameters of a node and return what it says to each."""
        request = SetParameters.Request(
            parameters=[
                Parameter(name.replace("__", "."), value=value).to_parameter_msg()
                for name, value in values.items()
            ]
        )
        return list(self.ask(f"{node}/set_parameters", request).results)

    def send_goal(self, goal: Vector) -> None:
        """Bring a goal into force and judge the run by it.

        A controller that was killed is discovered as if it lived for some time after, so that
        the first message may go to nobody.
        """
        end = time.monotonic() + READY
        self.goals.wait_for_controller(READY)
        while True:
            try:
                self.goals.send(goal, RADIUS, _REPEAT)
                return
            except GoalNotAcceptedError:
                if time.monotonic() > end:
                    raise

    def close(self) -> None:
        """End all processes and leave the graph."""
        stop_together(list(self.processes.values()))
        self._executor.shutdown()
        self.node.destroy_node()


@contextmanager
def joined(settings: SessionSettings) -> Iterator[FaultSession]:
    """Make a session whose nodes are up, and end it whatever happens."""
    start_ros([], quiet=True)
    try:
        session = FaultSession(settings)
        try:
            session.prepare()
            yield session
        finally:
            session.close()
    finally:
        rclpy.try_shutdown()


def _each(option: str, values: list[str]) -> list[str]:
    return [part for value in values for part in (option, value)]


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
