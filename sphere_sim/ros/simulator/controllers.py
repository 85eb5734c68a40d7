# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the simulator knows of the nodes that send commands: limits, lockstep and status."""

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.parameter import parameter_value_to_python

from sphere_nmpc.errors import shown
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_sim.world.drives import PLANNED_LIMITS

_REQUESTS = ([f"robot.{name}" for name in PLANNED_LIMITS], ["lockstep"])
"""Parameters by request; where one does not exist, rclpy answers a request with nothing."""
_RECENT = 1.0
"""Age up to which a status is a sign of life [s, wall]: controllers repeat it every 0.4 s."""


class Controllers:
    """Parameters of each node that sends commands, requested once and without waiting.

    `senders` returns the full names of these nodes, as far as they are known. In lockstep
    simulated time waits for commands, so that the status of the controller matters as well.
    """

    def __init__(
        self, node: GuardedNode, senders: Callable[[], list[str]], lockstep: bool
    ) -> None:
        self._node, self._senders = node, senders
        self._clients: dict[str, Client] = {}
        self._requested: set[str] = set()
        self.limits: dict[str, dict[str, float]] = {}
        """Values of `PLANNED_LIMITS` by node; nodes without these parameters are left out."""
        self.free_running: set[str] = set()
        """Nodes whose parameter ``lockstep`` is false."""
        self.status = ""
        """Message of the newest status; received in lockstep only."""
        self._heard_at = -math.inf
        if lockstep:
            node.create_subscription(DiagnosticStatus, "controller/status", self._hear, 1)

    def update(self) -> None:
        """Request the parameters of nodes that are new, and forget those of nodes that ended."""
        senders = self._senders()
        for name in self._clients.keys() - set(senders):
            self._node.destroy_client(self._clients.pop(name))
            self._requested.discard(name)
            self.limits.pop(name, None)
            self.free_running.discard(name)
        for name in senders:
            if name not in self._clients:
                service = f"{name}/get_parameters"
                self._clients[name] = self._node.create_client(GetParameters, service)
            if name not in self._requested and self._clients[name].service_is_ready():
                self._requested.add(name)
                take = self._node.guarded(f"limits of {name} refused", partial(self._take, name))
                for names in _REQUESTS:
                    request = GetParameters.Request(names=names)
                    self._clients[name].call_async(request).add_done_callback(take)

    def why_silent(self, waited: float) -> str:
        """Return why no command came within `waited` [s, wall] in lockstep, and the remedy."""
        if not self._senders():
            return "its sender has ended: start the controller again"
        if self.free_running:
            name = min(self.free_running)
            return f"{name} does not run in lockstep: start it with -p lockstep:=true"
        if time.monotonic() < self._heard_at + max(waited, _RECENT):
            return f"the controller is there and reports {shown(self.status)}"
        return "there is no status of the controller either: it hangs, was killed or still plans"

    def _take(self, name: str, answer: Any) -> None:
        if name not in self._clients:
            return
        known = [parameter_value_to_python(value) for value in answer.result().values]
        if any(value is False for value in known):
            self.free_running.add(name)
        complete = [number for number in known if isinstance(number, float)]
        if len(complete) == len(PLANNED_LIMITS):
            self.limits[name] = dict(zip(PLANNED_LIMITS, complete, strict=True))

    def _hear(self, status: DiagnosticStatus) -> None:
        self.status, self._heard_at = status.message, time.monotonic()
