# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Runs of running nodes to a goal: sending it, and serving a node until it was reached."""

import math
import time
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from sphere_nmpc.control.goal_client import NavigatorSettings
from sphere_nmpc.errors import InvalidStateError, SphereNmpcError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.cdr import seconds
from sphere_nmpc.ros.messages import pose_from_ros, stamp_from_ros
from sphere_sim.evaluation.metrics import SETTLED_ERROR, GoalRun
from sphere_sim.ros.session.goal_messages import pose_message
from sphere_sim.ros.session.goal_sender import GoalNotAcceptedError, GoalSender
from sphere_sim.ros.session.serving import serve_until

STALL_TIMEOUT = 30.0
"""Wall time without progress of control time after which a run is given up [s]."""
_PATIENT = NavigatorSettings(controller_timeout=3600.0)
"""Patience of who sends a goal: the caller says how long."""
_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class StalledError(SphereNmpcError):
    """Control time stands still."""


def wait_until_settled(
    run: GoalRun, spin: Callable[[], object], deadline: float,
    stall_timeout: float = STALL_TIMEOUT, not_before: float = -math.inf, linger: float = 0.0,
) -> float | None:
    """Return the control time at which the sphere reached its goal [s]; None if it did not.

    `spin` serves the node for a moment, which gives the run its poses. It is called until the
    run has settled, see `GoalRun.settled_at`, and for `linger` [s, control time] after that, at
    most until `deadline` [s, control time]. `StalledError` is raised after `stall_timeout` [s,
    wall time] without progress of control time.
    """
    settled, end = None, deadline
    newest, advanced = -math.inf, time.monotonic()
    while not run.time >= end:
        spin()
        if run.time > newest:
            newest, advanced = run.time, time.monotonic()
        elif time.monotonic() > advanced + stall_timeout:
            raise StalledError(f"control time stands still at {run.time:.2f} s")
        if settled is None and (settled := run.settled_at(not_before)) is not None:
            end = min(run.time + linger, deadline)
    return settled


class GoalRunner:
    """Sender of goals to the robot in the namespace of `node`, which follows its runs."""

    def __init__(self, node: Node, spin: Callable[[], object]) -> None:
        self._spin = spin
        self.sender = GoalSender(node, spin, _PATIENT)
        self.time = math.nan
        """Control time of the newest pose [s]."""
        self.run: GoalRun | None = None
        """The run to the goal that was sent last."""
        node.create_subscription(PoseStamped, "pose", self._take_pose, _NEWEST)

    def prepare(self, timeout: float) -> None:
        """Wait for the controller and a first pose, at most `timeout` [s, wall time].

        `GoalNotAcceptedError` is raised if one of them is not there by then.
        """
        end = time.monotonic() + timeout
        self.sender.wait_for_controller(timeout)
        left = end - time.monotonic()
        if not serve_until(self._spin, lambda: not math.isnan(self.time), left):
            raise GoalNotAcceptedError(f"no pose was published within {timeout:g} s")

    def send(
        self, goal: Vector, timeout: float, tolerance: float = SETTLED_ERROR, hold: float = 1.0
    ) -> GoalRun:
        """Bring a goal into force, see `GoalSender.send`, and begin a run to it, see `GoalRun`."""
        self.sender.send(pose_message(goal), timeout)
        self.run = GoalRun(goal, tolerance, hold)
        return self.run

    def go(self, goal: Vector, timeout: float, send_timeout: float) -> float | None:
        """Send a goal, shape (6,), and return the control time [s] until the sphere reached it.

        It is None where the goal is given up, after `timeout` [s, control time]; the other times
        and the errors are those of `GoalSender.send` and `wait_until_settled`.
        """
        sent = self.time
        run = self.send(goal, send_timeout)
        settled = wait_until_settled(run, self._spin, sent + timeout)
        return None if settled is None else settled - sent

    def _take_pose(self, message: Any) -> None:
        try:
            state = pose_from_ros(message)
        except InvalidStateError:
            return
        self.time = seconds(stamp_from_ros(message.header.stamp))
        if self.run is not None:
            self.run.observe(self.time, state)
