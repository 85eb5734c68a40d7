# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The demo's own node, which waits for the others, sends the goal, starts time and observes."""

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
from sphere_nmpc.model.state import angle_error, position_error
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.messages import joint_states_from_ros, pose_from_ros, seconds, stamp_from_ros
from sphere_nmpc.ros.startup import start_ros
from sphere_sim.ros.session.goal_run import GoalRun
from sphere_sim.ros.session.goal_sender import GoalSender
from sphere_sim.ros.session.other_publishers import require_sole_publishers
from sphere_sim.ros.session.serving import serve_until

_RECEIVED = ("/clock", "/pose", "/controller/active_goal")
"""Topics of which the recorder must have a message before time starts; the simulator repeats
its own while it is paused."""
_MATCHED = ("/odom", "/joint_states", "/rotor_trajectory", "/rotor_commands", "/controller/status")
"""Topics to whose publishers the recorder must be matched before time starts."""
_SPIN = 5e-3
"""Longest wait of the executor for a message [s]."""
_RESPONSE_TIMEOUT = 5.0
"""Longest wait for the response of a service [s]."""


class NotReadyError(SphereNmpcError):
    """The nodes were not ready in time."""


@dataclass(frozen=True)
class Progress:
    """Newest values of a run.

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


class DemoSession:
    """Node that sends the goal, starts simulated time and follows the run.

    Parameters
    ----------
    run : GoalRun
        The run to the goal.
    shell_radius : float
        Height of the centre [m].
    check : callable
        Raises when waiting has become useless, as a node has ended.
    """

    def __init__(self, run: GoalRun, shell_radius: float, check: Callable[[], object]) -> None:
        self.run = run
        self._radius = shell_radius
        self._check = check
        self._node = GuardedNode("demo")
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
        """Wait until every node is ready, and bring the goal into force; time is paused meanwhile.

        Parameters
        ----------
        timeout : float
            Longest wait [s].

        Raises
        ------
        NotReadyError, GoalNotAcceptedError
            If the nodes are not ready in time.
        DomainInUseError
            If other publishers have appeared in the domain meanwhile.
        """
        end = time.monotonic() + timeout
        self._sender.wait_for_controller(timeout)
        self._await(self._pause.service_is_ready, end, "the simulator's services")
        self._await(self._recorder.service_is_ready, end, "the recorder's services")
        self._sender.send(self.run.goal, self._radius, max(1.0, end - time.monotonic()))
        self._await(self._recorder_is_ready, end, "the recorder to receive every topic")
        require_sole_publishers(self._node)

    def start(self) -> None:
        """Start simulated time."""
        self._call(self._pause, SetBool.Request(data=False))

    def halt(self) -> None:
        """Pause simulated time."""
        self._call(self._pause, SetBool.Request(data=True))

    def spin(self, duration: float = 0.05) -> None:
        """Serve the node for `duration` [s, wall time], then call `check`.

        With another timeout each time rclpy would serve only the first subscription that has
        messages.
        """
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=_SPIN)
        self._check()

    def close(self) -> None:
        """Destroy the node."""
        self._executor.shutdown()
        self._node.destroy_node()

    def _recorder_is_ready(self) -> bool:
        lines = self._call(self._recorder, Trigger.Request()).message.splitlines()
        return not _missing(lines, ("received",), _RECEIVED) and not _missing(
            lines, ("received", "matched"), _MATCHED
        )

    def _await(self, condition: Callable[[], bool], end: float, what: str) -> None:
        if not serve_until(self.spin, condition, end - time.monotonic()):
            raise NotReadyError(f"timed out while waiting for {what}")

    def _call(self, client: Any, request: Any) -> Any:
        future = client.call_async(request)
        if not serve_until(lambda: self.spin(0.01), future.done, _RESPONSE_TIMEOUT):
            raise NotReadyError(
                f"no response of {client.srv_name} within {_RESPONSE_TIMEOUT:g} s"
            )
        return future.result()

    def _note_pose(self, message: Any) -> None:
        try:
            state = pose_from_ros(message)
        except InvalidStateError:
            return
        self.run.observe(seconds(stamp_from_ros(message.header.stamp)), state)
        self.progress = replace(
            self.progress,
            time=self.run.time,
            error=self.run.error,
            position_error=position_error(state, self.run.goal),
            angle_error=angle_error(state, self.run.goal),
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
    """Return the topics that the recorder does not report in one of these states."""
    there = [line.partition(" ")[2] for line in lines if line.partition(" ")[0] in states]
    return [topic for topic in topics if not any(name.endswith(topic) for name in there)]


@contextmanager
def demo_session(
    run: GoalRun, shell_radius: float, check: Callable[[], object]
) -> Iterator[DemoSession]:
    """Initialise rclpy and yield a `DemoSession` with these parameters."""
    # Without handlers of rclpy's own: on Ctrl-C the caller has to end its child processes.
    start_ros([], quiet=True)
    try:
        session = DemoSession(run, shell_radius, check)
        try:
            yield session
        finally:
            session.close()
    finally:
        rclpy.try_shutdown()
