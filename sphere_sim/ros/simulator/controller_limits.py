# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Limits of the drives that the controller plans within, read from its parameters."""

from collections.abc import Callable
from functools import partial
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.parameter import parameter_value_to_python

from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_sim.world.limits import PLANNED_LIMITS

_REQUEST = GetParameters.Request(names=[f"robot.{name}" for name in PLANNED_LIMITS])


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

    def update(self) -> None:
        """Request the limits of nodes that are new, and forget those of nodes that ended."""
        senders = self._senders()
        for name in self._clients.keys() - set(senders):
            self._node.destroy_client(self._clients.pop(name))
            self._requested.discard(name)
            self.found.pop(name, None)
        for name in senders:
            if name not in self._clients:
                service = f"{name}/get_parameters"
                self._clients[name] = self._node.create_client(GetParameters, service)
            if name not in self._requested and self._clients[name].service_is_ready():
                self._requested.add(name)
                take = self._node.guarded(f"limits of {name} refused", partial(self._take, name))
                self._clients[name].call_async(_REQUEST).add_done_callback(take)

    def _take(self, name: str, answer: Any) -> None:
        numbers = [parameter_value_to_python(value) for value in answer.result().values]
        complete = [number for number in numbers if isinstance(number, float)]
        if name in self._clients and len(complete) == len(PLANNED_LIMITS):
            self.found[name] = dict(zip(PLANNED_LIMITS, complete, strict=True))
