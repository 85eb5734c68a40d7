# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of other nodes as they were at the start, for a bag that explains itself."""

import json
from typing import Any

from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from sphere_sim.recording.run_reader import PARAMETERS_PREFIX


class ParameterSnapshots:
    """Ask nodes for all their parameters, once each, without waiting.

    Parameters
    ----------
    node : Node
        The node that asks.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._clients: dict[str, AsyncParameterClient | None] = {}
        self._values: dict[str, dict[str, Any]] = {}

    def ask(self, name: str) -> None:
        """Ask a node, by its full name, if that has not been done and it answers by now."""
        if name in self._values or self._clients.get(name, self) is None:
            return
        client = self._clients.get(name)
        if client is None:
            client = AsyncParameterClient(self._node, name)
            self._clients[name] = client
        if client.services_are_ready():
            self._clients[name] = None
            self._list(name, client)

    def as_text(self) -> dict[str, str]:
        """Return what is known so far, as custom data of a bag."""
        texts = {
            f"{PARAMETERS_PREFIX}{node}": json.dumps(values, sort_keys=True)
            for node, values in self._values.items()
        }
        for values in self._values.values():
            if "seed" in values:
                texts["seed"] = str(values["seed"])
        return texts

    def _list(self, node: str, client: AsyncParameterClient) -> None:
        def listed(future: Any) -> None:
            names = list(future.result().result.names)
            client.get_parameters(names).add_done_callback(
                lambda got: self._note(node, names, got.result().values)
            )

        client.list_parameters().add_done_callback(listed)

    def _note(self, node: str, names: list[str], values: Any) -> None:
        self._values[node] = {
            name: _plain(parameter_value_to_python(value))
            for name, value in zip(names, values, strict=False)
        }


def _plain(value: Any) -> Any:
    """Return arrays as lists and bytes as text, as JSON needs them."""
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    return list(value) if hasattr(value, "__iter__") and not isinstance(value, str) else value
