# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitor of the ROS graph around a node: its faults, each with its remedy, and their log."""

import math
import re
import time
from collections.abc import Iterable, Sequence, Set
from itertools import product
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosgraph_msgs.msg import Clock

from sphere_nmpc.errors import shown
from sphere_nmpc.reporting.conditions import Condition, Kind, worst_first
from sphere_nmpc.reporting.fault_log import FaultLog, LastingFaults
from sphere_nmpc.ros.network import network_addresses, reaches_other_machines

NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
"""Callbacks of subscriptions whose incompatible publishers a `GraphMonitor` logs, not rclpy."""
UNKNOWN = "a node without a name"
"""Stands for the name of a node of which only a topic has been discovered yet."""
INVALID = "a node whose name is invalid"
"""Stands for a name that no ROS node can have, but any participant of DDS can announce."""
_NAME = re.compile(r"(?=.{1,200}\Z)(/[A-Za-z_][A-Za-z0-9_]*)+")
"""Full name of a node or topic, of a length that leaves room for that of a service."""
NAMED_WITHIN = 3.0
"""Longest wait for the name of a node that was found [s, wall]; it mostly follows within one."""
_OF_EVERY_NODE = {"/rosout", "/parameter_events"}
_USE_NAMESPACE = "start a further robot in a namespace, -r __ns:=/second"
CLOCK_EFFECT, POSE_EFFECT = "time jumps between them", "the pose jumps between them"
"""What several publishers of clock and pose cause."""
_MOST_NAMES = 8
"""Names of nodes in a message."""
_KILLED = "a node that was killed is counted for up to 20 s"


class GraphMonitor:
    """Monitor of the present faults, which logs the beginning and the end of each."""

    def __init__(self, node: Node, fault_log: FaultLog) -> None:
        self._node = node
        self._lasting = LastingFaults(fault_log, lambda line: node.get_logger().info(line))
        self._announced = network_addresses() if reaches_other_machines() else None
        self.faults: tuple[Condition, ...] = ()
        """The present faults, the worst first."""
        self._since: dict[str, float] = {}

    def update(self, found: Sequence[Condition]) -> None:
        """Take `found` as the present faults, and log which are new and which have ended.

        That of the network is added here. A fault of a node without a name is logged once the
        name is known, or after `NAMED_WITHIN`.
        """
        if self._announced is not None:
            found = [*found, *network_fault(self._announced, network_addresses())]
        now = time.monotonic()
        self.faults = worst_first(found)
        self._since = {
            fault.name: self._since.get(fault.name, now) if UNKNOWN in fault.text else -math.inf
            for fault in found
        }
        self._lasting.update({
            fault.name: fault.text for fault in found
            if now > self._since[fault.name] + NAMED_WITHIN
        })

    def publishers(self, topic: str, kind: type) -> list[str]:
        """Return the full names of the nodes that publish messages of a type, one an endpoint."""
        return [full_name(info) for info in publishers_of(self._node, topic, kind)]

    def known_publishers(self, topic: str, kind: type) -> list[str]:
        """Return the names that `publishers` returns, once they are known."""
        return [name for name in self.publishers(topic, kind) if name not in (UNKNOWN, INVALID)]

    def further_publishers(self, clocked: bool) -> list[Condition]:
        """Return the faults of further publishers of the pose and, if `clocked`, of the clock."""
        topics = [("/clock", Clock, CLOCK_EFFECT)] if clocked else []
        found: list[Condition] = []
        for name, kind, effect in (*topics, ("pose", PoseStamped, POSE_EFFECT)):
            topic = self._node.resolve_topic_name(name)
            found += several_publishers(topic, self.publishers(topic, kind), effect)
        return found

    def clock_topics(self) -> list[str]:
        """Return the topics on which a clock is published."""
        return [
            topic for topic, kinds in self._node.get_topic_names_and_types()
            if type_name(Clock) in kinds and _NAME.fullmatch(topic)
            and self._node.count_publishers(topic) > 0
        ]

    def incompatible(self) -> list[Condition]:
        """Return the faults of publishers and subscriptions between which nothing is delivered."""
        node, own = self._node, self._node.get_fully_qualified_name()
        topics = {end.topic_name for end in node.subscriptions}
        topics |= {end.topic_name for end in node.publishers}
        wanted = {end.topic_name: type_name(end.msg_type) for end in node.subscriptions}
        found: dict[str, Condition] = {}
        for topic in sorted(topics - _OF_EVERY_NODE):
            # From the graph: a node's own profiles leave open what the middleware decides.
            publishers = node.get_publishers_info_by_topic(topic)
            subscribers = node.get_subscriptions_info_by_topic(topic) if publishers else []
            # Where some messages pass, those of another type do no harm.
            if topic in wanted and wanted[topic] not in {it.topic_type for it in publishers}:
                found |= {fault.name: fault for fault in other_types(
                    topic, wanted[topic], publishers)}
            for publisher, subscriber in product(publishers, subscribers):
                ends = {full_name(publisher), full_name(subscriber)}
                if own not in ends or topic in found or publisher.topic_type != (
                    subscriber.topic_type
                ):
                    continue
                fit, reason = qos_check_compatible(publisher.qos_profile, subscriber.qos_profile)
                if fit == QoSCompatibility.ERROR:
                    other = ", ".join(ends - {own}) or own
                    given = reason.removeprefix("ERROR: ").rstrip(";").lower()
                    found[topic] = Condition(
                        Kind.INCOMPATIBLE_QOS,
                        f"given {given} ({other}), expected qualities of service that fit; no "
                        f"message passes; 'ros2 topic info -v {topic}' shows both sides",
                        topic,
                    )
        return list(found.values())


def type_name(kind: Any) -> str:
    """Return the name of a message type as the graph has it."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def publishers_of(node: Node, topic: str, kind: type) -> list[TopicEndpointInfo]:
    """Return the publishers of a topic whose messages a subscription of this type can receive."""
    return [info for info in node.get_publishers_info_by_topic(topic)
            if info.topic_type == type_name(kind)]


def other_types(
    topic: str, expected: str, publishers: Sequence[TopicEndpointInfo]
) -> list[Condition]:
    """Return the fault of publishers of a topic that send another type than that expected."""
    others = [info for info in publishers if info.topic_type != expected]
    if not others:
        return []
    given = ", ".join(sorted({shown(info.topic_type)[1:-1] for info in others}))
    return [
        Condition(
            Kind.OTHER_TYPE,
            f"given a publisher of {topic} of type {given} ({names_of(map(full_name, others))}), "
            f"expected {expected}; its messages are not received: remap one side, "
            f"-r {topic}:=/its/topic",
            topic,
        )
    ]


def full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of the node of an endpoint.

    It is `UNKNOWN` until the node is discovered, and `INVALID` where it announces no valid name.
    """
    if "UNKNOWN" in info.node_name:
        return UNKNOWN
    name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
    return name if _NAME.fullmatch(name) else INVALID


def several_publishers(topic: str, nodes: Sequence[str], effect: str) -> list[Condition]:
    """Return the fault of a topic that more than one of `nodes` publishes, with its effect."""
    if len(nodes) < 2:
        return []
    return [
        Condition(
            Kind.OTHER_PUBLISHER,
            f"given {len(nodes)} ({names_of(nodes)}), expected one; {effect}; "
            f"{_USE_NAMESPACE}; {_KILLED}",
            topic,
        )
    ]


def names_of(nodes: Iterable[str]) -> str:
    """Return the names of nodes for a message, a few of them if there are many."""
    names = sorted(nodes)
    more = ["..."] if len(names) > _MOST_NAMES else []
    return ", ".join([*names[:_MOST_NAMES], *more])


def network_fault(announced: Set[str], present: Set[str]) -> list[Condition]:
    """Return the fault of a node whose right address other machines do not get.

    `announced` are the addresses of this machine when the node started, which Fast DDS announces
    as long as the node runs, `present` those that it has now.
    """
    if not present or announced & present:
        return []
    before, now = (", ".join(sorted(some)) or "none" for some in (announced, present))
    return [
        Condition(
            Kind.NETWORK,
            f"given the address {now}, expected the one that this node announces since "
            f"its start ({before}); nodes on other machines cannot find it: restart it",
        )
    ]
