# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of other nodes, for storage with a bag."""

import json
from typing import Any

from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from sphere_sim.recording.bag_files import PARAMETERS_PREFIX


class ParameterSnapshots:
    """Parameters of other nodes, requested once from each without waiting.

    Parameters
    ----------
    node : Node
        Node that sends the requests.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._clients: dict[str, AsyncParameterClient] = {}
        self._requested: set[str] = set()
        self._values: dict[str, dict[str, Any]] = {}

    def request(self, name: str) -> None:
        """Request the parameters of a node, by its full name, once its services are ready."""
        if name in self._requested:
            return
        if name not in self._clients:
            self._clients[name] = AsyncParameterClient(self._node, name)
        if self._clients[name].services_are_ready():
            self._requested.add(name)
            self._request_names(name, self._clients[name])

    def custom_data(self) -> dict[str, str]:
        """Return the parameters received so far as custom data of a bag."""
        texts = {
            f"{PARAMETERS_PREFIX}{node}": json.dumps(values, sort_keys=True)
            for node, values in self._values.items()
        }
        for values in self._values.values():
            if "seed" in values:
                texts["seed"] = str(values["seed"])
        return texts

    def _request_names(self, node: str, client: AsyncParameterClient) -> None:
        def request_values(future: Any) -> None:
            names = list(future.result().result.names)
            client.get_parameters(names).add_done_callback(
                lambda answer: self._store(node, names, answer.result().values)
            )

        client.list_parameters().add_done_callback(request_values)

    def _store(self, node: str, names: list[str], values: Any) -> None:
        self._values[node] = {
            name: _json_value(parameter_value_to_python(value))
            for name, value in zip(names, values, strict=False)
        }


def _json_value(value: Any) -> Any:
    """Return arrays as lists, and each byte as a number, which JSON can represent."""
    if isinstance(value, bytes):
        return int.from_bytes(value, "little")
    is_array = hasattr(value, "__iter__") and not isinstance(value, str)
    return [_json_value(item) for item in value] if is_array else value
