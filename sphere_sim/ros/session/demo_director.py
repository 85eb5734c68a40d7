# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Brings a simulator, a controller and a recorder together, starts time, and watches the run."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.errors import InvalidInputError, InvalidStateError, SphereNmpcError
from sphere_nmpc.model.state import Vector, angle_error, position_error, state_error
from sphere_nmpc.ros.conversions import (
    joint_states_from_ros,
    pose_from_ros,
    seconds,
    stamp_from_ros,
)
from sphere_nmpc.ros.startup import start_ros
from sphere_sim.ros.session.domain_guests import refuse_company
from sphere_sim.ros.session.goal_sender import GoalSender

_HEARD = ("/clock", "/pose", "/controller/active_goal")
"""What the recorder must have heard before time starts; the simulator repeats while paused."""
_MATCHED = ("/odom", "/joint_states", "/rotor_trajectory", "/rotor_commands", "/controller/status")
"""What it must be ready for."""


class NotReadyError(SphereNmpcError):
    """The nodes did not come together in time."""


@dataclass(frozen=True)
class Progress:
    """Where a run is.

    Attributes
    ----------
    time : float
        Simulated time [s].
    error : float
        ||x - x_d|| [mixed units].
    position_error, angle_error : float
        Distance [m] and angle [rad] to the goal.
    rotor_speeds : tuple of float
        Newest rotor speeds [rad/s].
    solve_time : float
        Newest solve time [s].
    """

    time: float = 0.0
    error: float = math.nan
    position_error: float = math.nan
    angle_error: float = math.nan
    rotor_speeds: tuple[float, float] = (0.0, 0.0)
    solve_time: float = math.nan


class DemoDirector:
    """A node that sends the goal, lets time start, and follows what happens.

    Parameters
    ----------
    goal : ndarray, shape (6,)
        The goal.
    shell_radius : float
        Height of the centre [m].
    check : callable
        Raises when there is no use in waiting on.
    """

    def __init__(self, goal: Vector, shell_radius: float, check: Callable[[], object]) -> None:
        self._goal = goal
        self._radius = shell_radius
        self._check = check
        self._node = rclpy.create_node("demo")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._sender = GoalSender(self._node, self.spin)
        self._pause = self._node.create_client(SetBool, "simulator/pause")
        self._recorder = self._node.create_client(Trigger, "recorder/is_recording")
        self.progress = Progress()
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._node.create_subscription(PoseStamped, "pose", self._note_pose, newest)
        self._node.create_subscription(JointState, "joint_states", self._note_joints, newest)
        self._node.create_subscription(DiagnosticStatus, "controller/status", self._note_solve, 10)

    def prepare(self, timeout: float) -> None:
        """Wait until every node is there, and bring the goal into force; time stands still.

        Parameters
        ----------
        timeout : float
            Longest wait [s].

        Raises
        ------
        NotReadyError, GoalNotAcceptedError
            If the nodes do not come together.
        DomainTakenError
            If others have come into the domain meanwhile.
        """
        end = time.monotonic() + timeout
        self._sender.wait_for_controller(timeout)
        self._await(self._pause.service_is_ready, end, "the simulator's services")
        self._await(self._recorder.service_is_ready, end, "the recorder's services")
        self._sender.send(self._goal, self._radius, max(1.0, end - time.monotonic()))
        self._await(self._recorder_hears, end, "the recorder to hear every topic")
        refuse_company(self._node)

    def start(self) -> None:
        """Let simulated time run."""
        self._ask(self._pause, SetBool.Request(data=False))

    def halt(self) -> None:
        """Let simulated time stand still."""
        self._ask(self._pause, SetBool.Request(data=True))

    def spin(self, duration: float = 0.05) -> None:
        """Serve the node until `duration` [s] has passed, and check that there is use in it."""
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)
        self._check()

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()

    def _recorder_hears(self) -> bool:
        lines = self._ask(self._recorder, Trigger.Request()).message.splitlines()
        return not _missing(lines, ("heard",), _HEARD) and not _missing(
            lines, ("heard", "matched"), _MATCHED
        )

    def _await(self, condition: Callable[[], bool], end: float, what: str) -> None:
        while not condition():
            if time.monotonic() > end:
                raise NotReadyError(f"waited in vain for {what}")
            self.spin()

    def _ask(self, client: Any, request: Any) -> Any:
        future = client.call_async(request)
        end = time.monotonic() + 5.0
        while not future.done():
            if time.monotonic() > end:
                raise NotReadyError(f"no answer from {client.srv_name} within 5 s")
            self.spin(0.01)
        return future.result()

    def _note_pose(self, message: Any) -> None:
        try:
            state = pose_from_ros(message)
        except InvalidStateError:
            return
        self.progress = replace(
            self.progress,
            time=seconds(stamp_from_ros(message.header.stamp)),
            error=state_error(state, self._goal),
            position_error=position_error(state, self._goal),
            angle_error=angle_error(state, self._goal),
        )

    def _note_joints(self, message: Any) -> None:
        try:
            _, speeds, _ = joint_states_from_ros(message)
        except InvalidInputError:
            return
        self.progress = replace(self.progress, rotor_speeds=(float(speeds[0]), float(speeds[1])))

    def _note_solve(self, message: Any) -> None:
        values = {pair.key: pair.value for pair in message.values}
        self.progress = replace(
            self.progress, solve_time=float(values.get("solve_time_s", "nan"))
        )


def _missing(lines: list[str], states: tuple[str, ...], topics: tuple[str, ...]) -> list[str]:
    """Return the topics of which the recorder's answer has none in these states."""
    there = [line.partition(" ")[2] for line in lines if line.partition(" ")[0] in states]
    return [topic for topic in topics if not any(name.endswith(topic) for name in there)]


@contextmanager
def directing(
    goal: Vector, shell_radius: float, check: Callable[[], object]
) -> Iterator[DemoDirector]:
    """Join the graph with a `DemoDirector`, whose parameters these are, and leave it again."""
    # The caller decides what Ctrl-C means: its children have to end as well.
    start_ros([], quiet=True)
    try:
        director = DemoDirector(goal, shell_radius, check)
        try:
            yield director
        finally:
            director.close()
    finally:
        rclpy.try_shutdown()
