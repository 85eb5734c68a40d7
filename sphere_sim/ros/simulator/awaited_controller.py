# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Causes for which a controller does not answer in lockstep, as far as the simulator can know."""

import math
import time
from collections.abc import Collection

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from sphere_nmpc.foreign_text import shown

_RECENT = 1.0
"""Age up to which a status is a sign of life [s, wall]: controllers repeat it every 0.4 s."""


class AwaitedController:
    """Subscriber of the status of the controller whose commands simulated time waits for.

    Parameters
    ----------
    node : Node
        Node of the subscription, in the namespace of the controller.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._message = ""
        self._heard_at = -math.inf
        self._status = node.create_subscription(
            DiagnosticStatus, "controller/status", self._take, 1
        )

    def cause(self, free_running: Collection[str], waited: float) -> str:
        """Return why there was no command for an instant, with the remedy.

        Parameters
        ----------
        free_running : collection of str
            Names of senders of commands that are known not to run in lockstep.
        waited : float
            How long the command was waited for [s, wall].
        """
        if not self._node.count_publishers("rotor_trajectory"):
            return "its sender has ended: start the controller again"
        if free_running:
            name = min(free_running)
            return f"{name} does not run in lockstep: start it with -p lockstep:=true"
        if time.monotonic() < self._heard_at + max(waited, _RECENT):
            return f"the controller is there and reports {shown(self._message)}"
        return "there is no status of the controller either: it hangs, was killed or still plans"

    def _take(self, status: DiagnosticStatus) -> None:
        self._message, self._heard_at = status.message, time.monotonic()
