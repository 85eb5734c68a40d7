# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the recorder finds in the ROS graph: qualities of service, parameters, missing topics."""

import json
import time
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

from sphere_nmpc.errors import shown
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_sim.recording.bag_files import PARAMETERS_PREFIX
from sphere_sim.recording.recorder_settings import DEFAULT_TOPICS, absolute, matches_any

_DEPTH = 2000
"""Queue length of a subscription: a simulation in lockstep does not wait for the recorder."""
_WITHIN = 5.0
"""Wall time within which nodes that start together find each other [s], on a busy machine too."""
_SHARED = frozenset(name for name in DEFAULT_TOPICS if name.startswith("/"))
"""Topics that all robots share: they have publishers whatever the namespace."""


def compatible_qos(offered: Sequence[QoSProfile], latched: bool = False) -> QoSProfile:
    """Return the strictest profile that is compatible with all publishers of a topic.

    While there is no publisher, kept messages are requested if the topic is `latched`.
    """
    reliable = all(qos.reliability is ReliabilityPolicy.RELIABLE for qos in offered)
    kept = all(map(is_latched, offered)) if offered else latched
    return QoSProfile(
        depth=_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )


def is_latched(profile: QoSProfile) -> bool:
    """Return whether a subscription receives messages that publishers keep."""
    return profile.durability is DurabilityPolicy.TRANSIENT_LOCAL


def qos_for_bag(profile: QoSProfile) -> Qos:
    """Return a profile in the form in which a bag stores it."""
    def same(kind: Any, policy: Any) -> Any:
        return kind.__members__.get(policy.name, kind.UNKNOWN)

    def time_of(duration: Any) -> QosTime:
        return QosTime(*divmod(duration.nanoseconds, NANOSECONDS))

    return Qos(
        same(QosHistory, profile.history), profile.depth,
        same(QosReliability, profile.reliability), same(QosDurability, profile.durability),
        time_of(profile.deadline), time_of(profile.lifespan),
        same(QosLiveliness, profile.liveliness), time_of(profile.liveliness_lease_duration),
        profile.avoid_ros_namespace_conventions,
    )


def full_name_of_topic(node: Node, name: str) -> str:
    """Return the full name of a topic or pattern as a node remaps it; patterns stay."""
    try:
        return str(node.resolve_topic_name(name))
    except RuntimeError:  # the error of rclpy for what is no name
        return absolute(name, node.get_namespace())


class ParameterSnapshots:
    """Parameters of other nodes, requested by `node` once from each without waiting."""

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
        client = self._clients[name]
        if not client.services_are_ready():
            return
        self._requested.add(name)

        def request_values(future: Any) -> None:
            names = list(future.result().result.names)
            client.get_parameters(names).add_done_callback(
                lambda answer: self._store(name, names, answer.result().values)
            )

        client.list_parameters().add_done_callback(request_values)

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


class MissingTopics:
    """Search for a publisher of any of the topics to record, until there is one.

    These are names and patterns; those without a leading slash are in the node's namespace.
    """

    def __init__(self, node: Node, names: Sequence[str]) -> None:
        self._node = node
        self._names = [name for name in names if name not in _SHARED]
        self._awaited = bool(self._names)
        self._due = time.monotonic() + _WITHIN

    def faults(self) -> list[Condition]:
        """Return the fault that none of the topics has a publisher, if that goes on."""
        if not self._awaited:
            return []
        node = self._node
        wanted = [full_name_of_topic(node, name) for name in self._names]
        published = [
            topic for topic, _ in node.get_topic_names_and_types() if node.count_publishers(topic)
        ]
        self._awaited = not any(matches_any(topic, wanted) for topic in published)
        if not self._awaited or time.monotonic() < self._due:
            return []
        more = " or its other topics" if len(wanted) > 1 else ""
        remedy = "start the robot or a simulator, or name its namespace, -r __ns:=/second"
        same = ((it, name) for name in self._names for it in sorted(published)
                if it.endswith(f"/{name}"))
        if found := next(same, None):
            topic, name = found
            namespace = topic.removesuffix(f"/{name}") or "/"
            remedy = f"there is {shown(topic)}: start this node with -r __ns:={shown(namespace)}"
        given = f"given no publisher of {wanted[0]}{more}, expected one"
        return [Condition(Kind.NOTHING_TO_RECORD, f"{given}; {remedy}")]
