# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Limits that the controller plans within, and its lockstep, read from its parameters."""

from collections.abc import Callable
from functools import partial
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.parameter import parameter_value_to_python

from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_sim.world.drives import PLANNED_LIMITS

_REQUESTS = ([f"robot.{name}" for name in PLANNED_LIMITS], ["lockstep"])
"""Parameters by request; where one does not exist, rclpy answers a request with nothing."""


class ControllerLimits:
    """Limits of each node that sends commands, requested once and without waiting.

    Parameters
    ----------
    node : GuardedNode
        Node that sends the requests.
    senders : callable
        Returns the full names of the nodes that send commands, as far as they are known.
    """

    def __init__(self, node: GuardedNode, senders: Callable[[], list[str]]) -> None:
        self._node = node
        self._senders = senders
        self._clients: dict[str, Client] = {}
        self._requested: set[str] = set()
        self.found: dict[str, dict[str, float]] = {}
        """Values of `PLANNED_LIMITS` by node; nodes without these parameters are left out."""
        self.free_running: set[str] = set()
        """Nodes whose parameter ``lockstep`` is false."""

    def update(self) -> None:
        """Request the limits of nodes that are new, and forget those of nodes that ended."""
        senders = self._senders()
        for name in self._clients.keys() - set(senders):
            self._node.destroy_client(self._clients.pop(name))
            self._requested.discard(name)
            self.found.pop(name, None)
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

    def _take(self, name: str, answer: Any) -> None:
        if name not in self._clients:
            return
        known = [parameter_value_to_python(value) for value in answer.result().values]
        if any(value is False for value in known):
            self.free_running.add(name)
        complete = [number for number in known if isinstance(number, float)]
        if len(complete) == len(PLANNED_LIMITS):
            self.found[name] = dict(zip(PLANNED_LIMITS, complete, strict=True))
