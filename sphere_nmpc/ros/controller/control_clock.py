# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Control time of a node: seconds on the ROS clock that it follows at present."""

from collections.abc import Callable

from rclpy.clock import ClockChange, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.node import Node

from sphere_nmpc.ros.conversions import seconds

_CHANGED = (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED)


class ControlClock:
    """Conversion from stamps to control time, with a report of jumps of the clock.

    In simulated time control time is the time on ``/clock``; otherwise it begins with the node.

    Parameters
    ----------
    node : Node
        The node whose clock it is.
    on_jump : callable
        Called after a jump back with None, and after a change between system and simulated
        clock (``use_sim_time``) with whether the clock is now a simulated one.
    """

    def __init__(self, node: Node, on_jump: Callable[[bool | None], object]) -> None:
        self._node = node
        self._on_jump = on_jump
        backwards = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True
        )
        self._jumps = node.get_clock().create_jump_callback(backwards, post_callback=self._jumped)
        self._begin()

    def stamp(self) -> int:
        """Return the present stamp [ns]; 0 before the first message on ``/clock``."""
        return int(self._node.get_clock().now().nanoseconds)

    def now(self) -> float | None:
        """Return control time [s]; None before the first message on ``/clock``."""
        stamp = self.stamp()
        return None if self.simulated and stamp == 0 else self.time_of(stamp)

    def time_of(self, stamp: int) -> float:
        """Return the control time [s] of a stamp [ns]."""
        return seconds(stamp, self.epoch)

    def _begin(self) -> None:
        self.simulated = bool(self._node.get_parameter("use_sim_time").value)
        """Whether the node follows ``/clock``."""
        self.epoch = 0 if self.simulated else self.stamp()
        """Stamp of control time 0 [ns]."""

    def _jumped(self, jump: TimeJump) -> None:
        changed = jump.clock_change in _CHANGED
        if changed:
            self._begin()
        self._on_jump(self.simulated if changed else None)
