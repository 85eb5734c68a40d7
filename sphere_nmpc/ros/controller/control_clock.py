# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Control time of a node: seconds on the ROS clock that it follows at present."""

from collections.abc import Callable

from rclpy.clock import ClockChange, JumpThreshold, ROSClock, TimeJump
from rclpy.duration import Duration
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from sphere_nmpc.ros.conversions import seconds
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.serialised import clock_stamp

_CHANGED = (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED)


class ControlClock:
    """Conversion from stamps to control time, with a report of jumps of the clock.

    In simulated time control time is the time on ``/clock``; otherwise it begins with the node.
    rclpy's subscription of ``/clock`` is taken over, as reading message objects with it takes as
    long as a solve.

    Parameters
    ----------
    node : GuardedNode
        The node whose clock it is.
    on_jump : callable
        Called after a jump back with None, and after a change between system and simulated
        clock (``use_sim_time``) with whether the clock is now a simulated one.
    """

    def __init__(self, node: GuardedNode, on_jump: Callable[[bool | None], object]) -> None:
        self._node = node
        clock = node.get_clock()
        if not isinstance(clock, ROSClock):
            raise TypeError(f"clock of the node: given {type(clock).__name__}, expected ROSClock")
        self._ros_clock = clock
        self._on_jump = on_jump
        self._heard: int | None = None
        backwards = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True
        )
        self._jumps = clock.create_jump_callback(backwards, post_callback=self._jumped)
        self._take = node.guarded(f"{node.resolve_topic_name('/clock')} refused", self._hear)
        self._begin()
        self.listen()

    def stamp(self) -> int:
        """Return the present stamp [ns]; 0 before the first message on ``/clock``."""
        if self._heard is not None:
            return self._heard
        return int(self._ros_clock.now().nanoseconds)

    def now(self) -> float | None:
        """Return control time [s]; None before the first message on ``/clock``."""
        stamp = self.stamp()
        return None if self.simulated and stamp == 0 else self.time_of(stamp)

    def time_of(self, stamp: int) -> float:
        """Return the control time [s] of a stamp [ns]."""
        return seconds(stamp, self.epoch)

    def listen(self) -> None:
        """Take over rclpy's subscription of ``/clock``, which it makes anew at each change."""
        for subscription in self._node.subscriptions if self.simulated else ():
            if subscription.msg_type is Clock and subscription.callback is not self._take:
                subscription.raw, subscription.callback = True, self._take

    def _hear(self, message: bytes) -> None:
        stamp = clock_stamp(message)
        self._heard = stamp
        clock = self._ros_clock
        clock.set_ros_time_override(Time(nanoseconds=stamp, clock_type=clock.clock_type))

    def _begin(self) -> None:
        self.simulated = bool(self._node.get_parameter("use_sim_time").value)
        """Whether the node follows ``/clock``."""
        self._heard = None
        self.epoch = 0 if self.simulated else self.stamp()
        """Stamp of control time 0 [ns]."""

    def _jumped(self, jump: TimeJump) -> None:
        changed = jump.clock_change in _CHANGED
        if changed:
            self._begin()
        self._on_jump(self.simulated if changed else None)
