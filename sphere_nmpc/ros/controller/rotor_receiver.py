# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Subscription of the measured rotor speeds, only while they are of use."""

from math import inf
from time import monotonic

from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.ros.cdr import LARGEST_JOINTS, rotor_speeds_and_stamp
from sphere_nmpc.ros.control_clock import ControlClock
from sphere_nmpc.ros.graph_monitor import NO_EVENTS
from sphere_nmpc.ros.guarded_node import GuardedNode

_NEWEST = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
_SPACING = 8e-3
"""Wall time between two messages that are read [s]: delays of a link are longer than this."""


class RotorReceiver:
    """Subscriber of ``joint_states`` while the controller's `Link` is in need of them.

    Without a link all commands soon turn out to take effect in time; the subscription then ends,
    as at a high rate its messages would take time from the control loop.
    """

    def __init__(
        self, node: GuardedNode, controller: Controller, clock: ControlClock
    ) -> None:
        self._node = node
        self._controller = controller
        self._clock = clock
        self._subscription: Subscription | None = None
        self._read_at = -inf
        self.update()

    def update(self) -> None:
        """Subscribe, or end the subscription, as needed; call it at intervals."""
        needed = self._controller.link.needs_speeds
        if needed and self._subscription is None:
            self._subscription = self._node.create_subscription(
                JointState, "joint_states", self._receive, _NEWEST, event_callbacks=NO_EVENTS,
                raw=True, largest=LARGEST_JOINTS,
            )
        elif not needed and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _receive(self, message: bytes) -> None:
        wall = monotonic()
        if wall < self._read_at + _SPACING:
            return
        now = self._clock.steady_now()
        try:
            speeds, stamp = rotor_speeds_and_stamp(message)
        except InvalidInputError:
            return
        if now is None or speeds is None:
            return
        time = self._clock.own_time(stamp, now)
        if time is not None:
            self._read_at = wall
            self._controller.observe_rotors(time, speeds)
