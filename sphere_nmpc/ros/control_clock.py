# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Control time of a node: seconds on the ROS clock that it follows at present."""

from collections.abc import Callable
from time import monotonic
from typing import Any

from rclpy.clock import ClockChange, JumpThreshold, ROSClock, TimeJump
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from sphere_nmpc.control.timing import MOST_AHEAD, ClockWatch
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.ros.cdr import clock_stamp, seconds
from sphere_nmpc.ros.guarded_node import GuardedNode

_RESOLVED = 10**15
"""Time [ns] up to which a float of seconds resolves a nanosecond: the knots of commands keep their
distances, on which the accelerations depend."""
_CHANGED = (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED)


class ControlClock:
    """Conversion from stamps to control time, with a watch for jumps of the clock.

    In simulated time control time is the time on ``/clock``, less a multiple of a million seconds
    where that is later, as when a bag is played; otherwise it begins with the node.

    The node passes the messages on ``/clock`` to `hear`. `on_jump` is called when the clock has
    jumped, when it has become steady again, and, with True, after a change between system and
    simulated clock (``use_sim_time``). For `has_pace` see `ClockWatch`.
    """

    def __init__(
        self, node: Node, on_jump: Callable[[bool], object], has_pace: bool = True
    ) -> None:
        self._has_pace = has_pace
        clock = node.get_clock()
        if not isinstance(clock, ROSClock):
            raise TypeError(f"clock of the node: given {type(clock).__name__}, expected ROSClock")
        self._ros_clock = clock
        self._on_jump = on_jump
        self._heard: int | None = None
        changes = JumpThreshold(min_forward=None, min_backward=None, on_clock_change=True)
        self._jumps = clock.create_jump_callback(changes, post_callback=self._changed)
        self._begin()

    def stamp(self) -> int:
        """Return the present stamp [ns]; 0 before the first message on ``/clock``."""
        if self._heard is not None:
            return self._heard
        return int(self._ros_clock.now().nanoseconds)

    def now(self) -> float | None:
        """Return control time [s]; None before the first message on ``/clock``."""
        stamp = self.stamp()
        if not self.simulated:
            self._watch(stamp)
        elif not stamp:
            return None
        return (stamp - self.epoch) / NANOSECONDS

    def steady_now(self) -> float | None:
        """Return control time [s]; None also while the clock jumps."""
        now = self.now()
        return now if self.watch.is_steady else None

    def final_now(self) -> float | None:
        """Return control time [s] for last commands; while the clock jumps that without jumps."""
        now = self.now()
        if now is None or self.watch.is_steady:
            return now
        return self.watch.expected(monotonic()) - seconds(self.epoch)

    def time_of(self, stamp: int) -> float:
        """Return the control time [s] of a stamp [ns]."""
        return (stamp - self.epoch) / NANOSECONDS

    def own_time(self, stamp: int, now: float) -> float | None:
        """Return the control time [s] of a stamp [ns]; None where it is of another clock.

        That is one too far from `now` [s], which this one shows.
        """
        time = (stamp - self.epoch) / NANOSECONDS
        return time if abs(time - now) < MOST_AHEAD else None

    def hear(self, message: bytes) -> None:
        """Set the node's clock to that of a serialised message on ``/clock``."""
        stamp = clock_stamp(message)
        if self._heard is None:
            self._set_epoch(stamp)
        self._heard = stamp
        clock = self._ros_clock
        clock.set_ros_time_override(Time(nanoseconds=stamp, clock_type=clock.clock_type))
        self._watch(stamp)

    def _watch(self, stamp: int) -> None:
        if self.watch.read(seconds(stamp), monotonic()):
            if self.simulated and self.watch.is_steady and not self.watch.has_returned:
                self._set_epoch(stamp)
            self._on_jump(False)

    def _set_epoch(self, stamp: int) -> None:
        if self._has_pace:  # in lockstep the simulator's sampling instants count from zero
            self.epoch = stamp // _RESOLVED * _RESOLVED

    def _begin(self) -> None:
        # Not from the parameter, which is changed only after the clock.
        self.simulated = self._ros_clock.ros_time_is_active
        """Whether the node follows ``/clock``."""
        self.watch = ClockWatch(self.simulated, self._has_pace)
        """Pace and jumps of the clock."""
        self._heard = None
        self.epoch = 0 if self.simulated else self.stamp()
        """Stamp of control time 0 [ns]."""

    def _changed(self, jump: TimeJump) -> None:
        if jump.clock_change in _CHANGED:
            self._begin()
            self._on_jump(True)


class ClockedNode(GuardedNode):
    """Node with a `ControlClock`, which a subclass makes before it is spun."""

    _control_clock: ControlClock

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., Any], qos_profile: Any,
        **options: Any,
    ) -> Subscription:
        """Create a subscription; rclpy's own one of ``/clock`` is served by `ControlClock`.

        rclpy makes it with the node and whenever ``use_sim_time`` is set. Its callback takes
        message objects, each of which takes as long as a solve.
        """
        if msg_type is Clock:
            callback, options = self._receive_clock, {**options, "raw": True}
        return super().create_subscription(msg_type, topic, callback, qos_profile, **options)

    def _receive_clock(self, message: bytes) -> None:
        self._control_clock.hear(message)
