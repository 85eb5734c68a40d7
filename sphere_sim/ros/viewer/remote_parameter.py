# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A parameter of another node, read now and then and set without waiting."""

import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

_PERIOD = 2.0
"""Wall time between two questions [s]."""


class RemoteParameter:
    """What is known of the parameter; nothing while its node is not there.

    Parameters
    ----------
    node : Node
        Who asks.
    remote : str
        Name of the node that has it.
    name : str
        Of the parameter.
    refused : callable
        Called with the reason when the node did not take a value that was set.
    """

    def __init__(
        self, node: Node, remote: str, name: str, refused: Callable[[str], object]
    ) -> None:
        self._name = name
        self._refused = refused
        self._client = AsyncParameterClient(node, remote)
        self._asked = -_PERIOD
        self._descriptor = ParameterDescriptor(read_only=True)
        self.value: Any = None
        """None where the node or the parameter is not there."""

    @property
    def writable(self) -> bool:
        """Whether it can be set while the node runs."""
        return self.value is not None and not self._descriptor.read_only

    @property
    def choices(self) -> tuple[str, ...]:
        """What it can be set to, where the node tells."""
        _, _, listed = self._descriptor.additional_constraints.partition("one of: ")
        return tuple(filter(None, listed.split(", ")))

    def refresh(self) -> None:
        """Ask, if it was not asked a moment ago; the answer comes when it comes."""
        now = time.monotonic()
        if now < self._asked + _PERIOD:
            return
        self._asked = now
        if not self._client.services_are_ready():
            self.value = None
            return
        self._client.get_parameters([self._name], callback=self._take_value)
        self._client.describe_parameters([self._name], callback=self._take_descriptor)

    def set(self, value: Any) -> None:
        """Ask for another value."""
        self.value, self._asked = value, time.monotonic()
        wanted = [Parameter(self._name, value=value)]
        self._client.set_parameters(wanted, callback=self._take_answer)

    def _take_value(self, future: Any) -> None:
        values = getattr(future.result(), "values", None) or [None]
        self.value = None if values[0] is None else parameter_value_to_python(values[0])

    def _take_descriptor(self, future: Any) -> None:
        descriptors = getattr(future.result(), "descriptors", None)
        if descriptors:
            self._descriptor = descriptors[0]

    def _take_answer(self, future: Any) -> None:
        results = getattr(future.result(), "results", None)
        if not results or not results[0].successful:
            self._refused(results[0].reason if results else f"{self._name}: no answer")
        self._asked = -_PERIOD  # what holds now is asked for at once
