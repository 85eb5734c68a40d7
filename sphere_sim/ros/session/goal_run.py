# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Runs to a goal: sending it, and serving the node until the sphere has settled there."""

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, state_error
from sphere_nmpc.ros.messages import pose_from_ros, seconds, stamp_from_ros
from sphere_sim.ros.session.goal_sender import GoalNotAcceptedError, GoalSender
from sphere_sim.ros.session.serving import serve_until

SETTLED = 1e-2
"""Error below which the sphere is at its goal [mixed units]."""
HOLD = 1.0
"""How long the error has to stay below that [s, control time]."""
STALL_TIMEOUT = 30.0
"""Wall time without progress of control time after which a run is given up [s]."""
_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class StalledError(SphereNmpcError):
    """Control time stands still."""


class GoalRun:
    """A run to one goal, judged from its poses.

    Parameters
    ----------
    goal : ndarray, shape (6,)
        The goal.
    tolerance : float, optional
        Error below which the sphere is at the goal [mixed units].
    hold : float, optional
        How long the error has to stay below it for the sphere to have settled [s].
    """

    def __init__(self, goal: Vector, tolerance: float = SETTLED, hold: float = HOLD) -> None:
        self.goal = goal
        self.time = math.nan
        """Control time of the newest pose [s]."""
        self.error = math.nan
        """||x - x_d|| of the newest pose [mixed units]."""
        self.inside_since: float | None = None
        """Time from which the error has been below the tolerance [s]; None while it is not."""
        self._tolerance = tolerance
        self._hold = hold

    def observe(self, time: float, state: Vector) -> None:
        """Take a pose, shape (6,), at a control time [s]."""
        self.time = time
        self.error = state_error(state, self.goal)
        if not self.error < self._tolerance:
            self.inside_since = None
        elif self.inside_since is None:
            self.inside_since = time

    def settled_at(self, not_before: float = -math.inf) -> float | None:
        """Return the time at which the sphere reached the goal, once it has stayed there.

        Parameters
        ----------
        not_before : float, optional
            Time from which its stay there counts [s].

        Returns
        -------
        float or None
            Time from which the error has been below the tolerance [s]; None as long as it has
            not stayed there for the required time.
        """
        since = self.inside_since
        if since is None or self.time < max(since, not_before) + self._hold:
            return None
        return since


def wait_until_settled(
    run: GoalRun,
    spin: Callable[[], object],
    deadline: float,
    stall_timeout: float = STALL_TIMEOUT,
    not_before: float = -math.inf,
) -> float | None:
    """Serve the node until the sphere has settled at its goal, or the time is up.

    Parameters
    ----------
    run : GoalRun
        The run, which is given its poses while the node is served.
    spin : callable
        Serves the node for a moment.
    deadline : float
        Control time at which the goal is given up [s].
    stall_timeout : float, optional
        Wall time without progress of control time after which the run is given up [s].
    not_before : float, optional
        See `GoalRun.settled_at`.

    Returns
    -------
    float or None
        Control time at which the goal was reached [s]; None if the time was up before.

    Raises
    ------
    StalledError
        If control time stands still.
    """
    for _ in _served(run, spin, deadline, stall_timeout):
        settled = run.settled_at(not_before)
        if settled is not None:
            return settled
    return None


def wait_until(
    run: GoalRun,
    spin: Callable[[], object],
    moment: float,
    stall_timeout: float = STALL_TIMEOUT,
) -> None:
    """Serve the node until a control time is reached [s]; otherwise as `wait_until_settled`."""
    for _ in _served(run, spin, moment, stall_timeout):
        pass


def _served(
    run: GoalRun, spin: Callable[[], object], deadline: float, stall_timeout: float
) -> Iterator[None]:
    """Serve the node repeatedly until the deadline, and yield each time."""
    newest, advanced = -math.inf, time.monotonic()
    while not run.time >= deadline:
        spin()
        if run.time > newest:
            newest, advanced = run.time, time.monotonic()
        elif time.monotonic() > advanced + stall_timeout:
            raise StalledError(f"control time stands still at {run.time:.2f} s")
        yield


class GoalRunner:
    """Sender of goals to one robot, which follows its runs.

    Parameters
    ----------
    node : Node
        Its namespace is that of the robot.
    spin : callable
        Serves the node for a moment.
    """

    def __init__(self, node: Node, spin: Callable[[], object]) -> None:
        self._spin = spin
        self._sender = GoalSender(node, spin)
        self._radius = RobotParameters().shell_radius
        self.time = math.nan
        """Control time of the newest pose [s]."""
        self.run: GoalRun | None = None
        """The run to the goal that was sent last."""
        node.create_subscription(PoseStamped, "pose", self._take_pose, _NEWEST)

    def prepare(self, timeout: float) -> None:
        """Wait for the controller and a first pose.

        Raises
        ------
        GoalNotAcceptedError
            If one of them is not there within `timeout` [s, wall time].
        """
        end = time.monotonic() + timeout
        self._sender.wait_for_controller(timeout)
        left = end - time.monotonic()
        if not serve_until(self._spin, lambda: not math.isnan(self.time), left):
            raise GoalNotAcceptedError(f"no pose was published within {timeout:g} s")

    def send(self, goal: Vector, timeout: float, repeat: float = math.inf) -> GoalRun:
        """Bring a goal into force, see `GoalSender.send`, and begin a run to it."""
        run = GoalRun(goal)
        self._sender.send(goal, self._radius, timeout, repeat)
        self.run = run
        return run

    def go(
        self, goal: Vector, timeout: float, send_timeout: float, repeat: float = math.inf
    ) -> float | None:
        """Send a goal, shape (6,), and wait until the sphere has settled there.

        Parameters
        ----------
        goal : ndarray, shape (6,)
            The goal.
        timeout : float
            Control time after which the goal is given up [s].
        send_timeout, repeat : float
            Wall times of `GoalSender.send` [s].

        Returns
        -------
        float or None
            Control time from sending to reaching the goal [s]; None if it was given up.

        Raises
        ------
        GoalNotAcceptedError
            If the controller does not confirm the goal.
        StalledError
            If control time stands still.
        """
        sent = self.time
        run = self.send(goal, send_timeout, repeat)
        settled = wait_until_settled(run, self._spin, sent + timeout)
        return None if settled is None else settled - sent

    def _take_pose(self, message: Any) -> None:
        self.time = seconds(stamp_from_ros(message.header.stamp))
        if self.run is not None:
            self.run.observe(self.time, pose_from_ros(message))
