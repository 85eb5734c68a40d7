# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameter of another node, polled and set without waiting, with others that are only read."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, ParameterValue
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from sphere_nmpc.errors import InvalidParameterError

_PERIOD = 2.0
"""Wall time between two polls [s]."""


class RemoteParameter:
    """Parameter of another node; unknown while that node is not running.

    `settings` is a dataclass with a field of this name. Values that it does not accept are taken
    as unknown: any node may have this name, and a parameter of any type. `on_refusal` is called
    with the reason if the node refuses a value; parameters in `read_only` are polled with it.
    """

    def __init__(
        self, node: Node, remote: str, name: str, settings: type,
        on_refusal: Callable[[str], object], read_only: Sequence[str] = (),
    ) -> None:
        self._name, self._settings, self._read_only = name, settings, tuple(read_only)
        self._on_refusal = on_refusal
        self._client = AsyncParameterClient(node, remote)
        self._polled = -_PERIOD
        self._changes = 0
        self._descriptor = ParameterDescriptor(read_only=True)
        self.value: Any = None
        """Value; None while the node or a valid parameter is not available."""
        self.others: tuple[Any, ...] = ()
        """Values of `read_only`, unchecked; empty while they are not available."""

    @property
    def writable(self) -> bool:
        """Whether the parameter can be set while its node runs."""
        return self.value is not None and not self._descriptor.read_only

    @property
    def choices(self) -> tuple[str, ...]:
        """Valid values that the description of the parameter lists, each once."""
        _, _, listed = self._descriptor.additional_constraints.partition("one of: ")
        return tuple(filter(self._accepts, dict.fromkeys(listed.split(", "))))

    def refresh(self) -> None:
        """Request the value, at most once a period; the answer arrives later."""
        now = time.monotonic()
        if now < self._polled + _PERIOD:
            return
        self._polled = now
        if not self._client.services_are_ready():
            self.value = None
            return
        take_value = partial(self._take_value, self._changes)
        self._client.get_parameters([self._name, *self._read_only], callback=take_value)
        self._client.describe_parameters([self._name], callback=self._take_descriptor)

    def set(self, value: Any) -> None:
        """Request another value."""
        self.value, self._polled = value, time.monotonic()
        self._changes += 1
        wanted = [Parameter(self._name, value=value)]
        self._client.set_parameters(wanted, callback=self._take_answer)

    def _take_value(self, changes: int, future: Any) -> None:
        if changes != self._changes:
            return  # the value before the newest change
        values = getattr(future.result(), "values", None) or ()
        found = [_plain(value) for value in values]
        self.value = found[0] if found and self._accepts(found[0]) else None
        self.others = tuple(found[1:])

    def _accepts(self, value: Any) -> bool:
        try:
            self._settings(**{self._name: value})
        except InvalidParameterError:
            return False
        return True

    def _take_descriptor(self, future: Any) -> None:
        descriptors = getattr(future.result(), "descriptors", None)
        if descriptors:
            self._descriptor = descriptors[0]

    def _take_answer(self, future: Any) -> None:
        results = getattr(future.result(), "results", None)
        if not results or not results[0].successful:
            self._on_refusal(results[0].reason if results else f"{self._name}: no answer")
        self._polled = -_PERIOD  # request the value in force immediately


def _plain(value: ParameterValue) -> Any:
    """Return the value of a message; None where its type is none of ROS."""
    try:
        return parameter_value_to_python(value)
    except RuntimeError:
        return None
