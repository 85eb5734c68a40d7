# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The launcher's own node, which waits for the others, sends the goal and starts time."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.cdr import rotor_speeds_and_stamp
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.startup import start_ros
from sphere_sim.evaluation.metrics import GoalRun
from sphere_sim.recording.message_fields import number
from sphere_sim.ros.session.goal_run import GoalRunner
from sphere_sim.ros.session.other_publishers import require_sole_publishers
from sphere_sim.ros.session.serving import serve_until

_RECEIVED = ("/clock", "/pose", "/controller/active_goal", "/robot_description")
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


class DemoSession:
    """Node that sends the goal, starts simulated time and follows the run; a context manager.

    rclpy is initialised without handlers of its own: on Ctrl-C the caller has to end its children.
    `check` raises when waiting has become useless, as a node has ended.
    """

    def __init__(self, check: Callable[[], object]) -> None:
        self._check = check
        start_ros([], quiet=True)
        self._node = GuardedNode("demo")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._runner = GoalRunner(self._node, self.spin)
        self.sender = self._runner.sender
        """Sender of the goal, with the newest status of the controller."""
        self._pause = self._node.create_client(SetBool, "simulator/pause")
        self._recorder = self._node.create_client(Trigger, "recorder/is_recording")
        self.rotor_speeds: Vector = np.zeros(2)
        """Newest rotor speeds [rad/s]."""
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._node.create_subscription(
            JointState, "joint_states", self._note_joints, newest, raw=True
        )

    def __enter__(self) -> "DemoSession":
        return self

    def __exit__(self, *exception: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown()

    @property
    def solve_time(self) -> float:
        """Newest solve time [s]."""
        return number(self.sender.values, "solve_time_s")

    def prepare(self, goal: Vector, tolerance: float, hold: float, timeout: float) -> GoalRun:
        """Wait until every node is ready, and bring the goal into force; time is paused meanwhile.

        Returns the run to the goal, which gets its poses while the node is served. An error is
        raised if the nodes are not ready within `timeout` [s], or other publishers have appeared
        in the domain meanwhile.
        """
        end = time.monotonic() + timeout
        self.sender.wait_for_controller(timeout)
        self._await(self._pause.service_is_ready, end, "the simulator's services")
        self._await(self._recorder.service_is_ready, end, "the recorder's services")
        left = max(1.0, end - time.monotonic())
        run = self._runner.send(goal, left, tolerance=tolerance, hold=hold)
        self._await(self._recorder_is_ready, end, "the recorder to receive every topic")
        require_sole_publishers(self._node)
        return run

    def pause(self, paused: bool) -> None:
        """Pause simulated time, or start it."""
        self._call(self._pause, SetBool.Request(data=paused))

    def spin(self, duration: float = 0.05) -> None:
        """Serve the node for `duration` [s, wall time], then call `check`.

        With another timeout each time rclpy would serve only the first subscription that has
        messages.
        """
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=_SPIN)
        self._check()

    def _recorder_is_ready(self) -> bool:
        lines = self._call(self._recorder, Trigger.Request()).message.splitlines()
        wanted = [*((topic, ("received ",)) for topic in _RECEIVED),
                  *((topic, ("received ", "matched ")) for topic in _MATCHED)]
        return all(any(line.startswith(states) and line.endswith(topic) for line in lines)
                   for topic, states in wanted)

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

    def _note_joints(self, message: bytes) -> None:
        speeds, _ = rotor_speeds_and_stamp(message)
        if speeds is not None:
            self.rotor_speeds = speeds
