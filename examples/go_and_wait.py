#!/usr/bin/env python3
# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Node that sends goals one after another, and waits for each until the sphere is there.

python examples/go_and_wait.py             # the goals below
python examples/go_and_wait.py 1 -1 90     # a pose: x, y [m], heading [deg]
python examples/go_and_wait.py 2 0         # a position, any orientation

It uses topics only, may be started before the controller, and exits with 1 and the reason where a
goal is not reached. With ``--ros-args -r __ns:=/second`` it is for the robot of that namespace.
"""

import math
import sys
import time
from collections.abc import Sequence

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

GOALS = [[1.0, -1.0, 90.0], [0.0, 0.0]]
"""Poses, x, y [m] and heading [deg], and positions, x and y [m]."""


class NotReachedError(Exception):
    """Goal that is not reached; the message is the reason."""


class GoAndWait(Node):
    """Node that knows of the controller what its status says."""

    def __init__(self) -> None:
        super().__init__("go_and_wait")
        self.declare_parameter("patience", 10.0)
        self._patience: float = self.get_parameter("patience").value
        """Wall time without an answer after which a goal is given up [s]."""
        self._poses = self.create_publisher(PoseStamped, "goal_pose", 1)
        self._points = self.create_publisher(PointStamped, "goal_point", 1)
        self.create_subscription(DiagnosticStatus, "controller/status", self._take_status, 10)
        self._values: dict[str, str] = {}
        self._problem = "there is no controller: nothing on controller/status"
        self._fine = time.monotonic()
        """When the controller was last heard to be able to move."""

    def go(self, goal: Sequence[float]) -> str:
        """Send a goal and return how it was reached; `NotReachedError` where it was not."""
        stamp = time.time_ns()  # by which the status tells whose goal is in force
        own = f"{stamp // 10**9}.{stamp % 10**9:09d}"
        self._send(goal, stamp, own)
        taken, began = self._values["time_s"], math.nan
        while True:
            self._wait_for_status()
            values, now = self._values, float(self._values["time_s"])
            began = now if math.isnan(began) else began  # not known before the first clock
            if values["goal_stamp"] != own:
                raise NotReachedError("another goal took over, or it was cancelled")
            if values["mode"] == "disabled":
                raise NotReachedError("the controller is disabled")
            if values["no_progress"]:
                raise NotReachedError(values["giving_up"] or values["no_progress"])
            # Until the next decision a status has the mode of the goal before.
            if values["mode"] == "at the goal" and values["time_s"] != taken:
                return f"{now - began:.1f} s, {float(values['error']):.0e} off"

    def _send(self, goal: Sequence[float], stamp: int, own: str) -> None:
        """Publish a goal until it is in force; `own` is the stamp [ns] as the status has it.

        What is sent before the controller is matched is lost, and repeating a goal has no effect.
        """
        message = PoseStamped() if len(goal) == 3 else PointStamped()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        place = message.pose.position if len(goal) == 3 else message.point
        place.x, place.y = float(goal[0]), float(goal[1])
        if len(goal) == 3:
            half = math.radians(goal[2]) / 2.0
            message.pose.orientation.z, message.pose.orientation.w = math.sin(half), math.cos(half)
        end = time.monotonic() + self._patience
        while time.monotonic() < end:
            (self._poses if len(goal) == 3 else self._points).publish(message)
            again = time.monotonic() + 1.0
            while time.monotonic() < again:
                rclpy.spin_once(self, timeout_sec=0.1)
                if self._values.get("goal_stamp") == own:
                    self._fine = time.monotonic()
                    return
        raise NotReachedError(self._problem or "the controller does not take it, see its log")

    def _wait_for_status(self) -> None:
        """Wait for a status; `NotReachedError` if for long none says that it can move."""
        before = self._values
        while self._values is before:
            rclpy.spin_once(self, timeout_sec=0.1)
            if time.monotonic() > self._fine + self._patience:
                raise NotReachedError(self._problem or "the controller is gone")

    def _take_status(self, status: DiagnosticStatus) -> None:
        self._values = {pair.key: pair.value for pair in status.values}
        self._problem = status.message
        if status.level in (DiagnosticStatus.OK, DiagnosticStatus.WARN):
            self._fine, self._problem = time.monotonic(), ""


def main() -> int:
    """Send the goals; 0 if all are reached, 1 otherwise."""
    rclpy.init(args=sys.argv)
    given = [float(word) for word in remove_ros_args(sys.argv)[1:]]
    node = GoAndWait()
    try:
        for goal in [given] if given else GOALS:
            print(f"goal {goal}: reached after {node.go(goal)}", flush=True)
    except NotReachedError as reason:
        print(f"goal {goal}: not reached: {reason}", file=sys.stderr)
        return 1
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
