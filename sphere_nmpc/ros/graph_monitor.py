# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitor of the ROS graph around a node: its faults, each with its remedy, and their log."""

import math
import re
import time
from collections.abc import Sequence, Set
from dataclasses import dataclass
from itertools import product

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo

from sphere_nmpc.fault_log import FaultLog, LastingFaults
from sphere_nmpc.ros.network import network_addresses, reaches_other_machines

_CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
"""For subscriptions whose incompatible publishers a `GraphMonitor` logs, rather than rclpy too."""
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
_MOST_NAMES = 8
"""Names of nodes in a message."""
_KILLED = "a node that was killed is counted for up to 20 s"


@dataclass(frozen=True)
class GraphFault:
    """A fault in the ROS graph: what is wrong, and what was given, expected and helps."""

    kind: str
    """In a few words that do not change."""
    message: str
    severe: bool = True
    """Whether it prevents the node from doing its work."""


class GraphMonitor:
    """Monitor of the present faults, which logs the beginning and the end of each."""

    def __init__(self, node: Node, fault_log: FaultLog) -> None:
        self._node = node
        self._lasting = LastingFaults(fault_log, lambda line: node.get_logger().info(line))
        self._announced = network_addresses() if reaches_other_machines() else None
        self.faults: list[GraphFault] = []
        """The present faults, the most severe first."""
        self._since: dict[str, float] = {}

    def update(self, found: Sequence[GraphFault]) -> None:
        """Take `found` as the present faults, and log which are new and which have ended.

        That of the network is added here. A fault of a node without a name is logged once the
        name is known, or after `NAMED_WITHIN`.
        """
        if self._announced is not None:
            found = [*found, *network_fault(self._announced, network_addresses())]
        now = time.monotonic()
        self.faults = list(found)
        self._since = {
            fault.kind: self._since.get(fault.kind, now) if UNKNOWN in fault.message else -math.inf
            for fault in found
        }
        self._lasting.update({
            fault.kind: fault.message for fault in found
            if now > self._since[fault.kind] + NAMED_WITHIN
        })

    def publishers(self, topic: str) -> list[str]:
        """Return the full names of the nodes that publish a topic, one for each endpoint."""
        return [full_name(info) for info in self._node.get_publishers_info_by_topic(topic)]

    def known_publishers(self, topic: str) -> list[str]:
        """Return the full names of the nodes that publish a topic, once their names are known."""
        return [name for name in self.publishers(topic) if name not in (UNKNOWN, INVALID)]

    def further_publishers(self, clocked: bool) -> list[GraphFault]:
        """Return the faults of further publishers of the pose and, if `clocked`, of the clock."""
        pose, clock = map(self._node.resolve_topic_name, ("pose", "/clock"))
        clocks = self.publishers(clock) if clocked else []
        return further_publishers(pose, self.publishers(pose), clock, clocks)

    def clock_topics(self) -> list[str]:
        """Return the topics on which a clock is published."""
        return [
            topic for topic, kinds in self._node.get_topic_names_and_types()
            if _CLOCK_TYPE in kinds and _NAME.fullmatch(topic)
            and self._node.count_publishers(topic) > 0
        ]

    def incompatible(self) -> list[GraphFault]:
        """Return the faults of publishers and subscriptions between which nothing is delivered."""
        node, own = self._node, self._node.get_fully_qualified_name()
        topics = {end.topic_name for end in node.subscriptions}
        topics |= {end.topic_name for end in node.publishers}
        found = {}
        for topic in sorted(topics - _OF_EVERY_NODE):
            # From the graph: a node's own profiles leave open what the middleware decides.
            publishers = node.get_publishers_info_by_topic(topic)
            subscribers = node.get_subscriptions_info_by_topic(topic) if publishers else []
            for publisher, subscriber in product(publishers, subscribers):
                ends = {full_name(publisher), full_name(subscriber)}
                if own not in ends or topic in found:
                    continue
                fit, reason = qos_check_compatible(publisher.qos_profile, subscriber.qos_profile)
                if fit == QoSCompatibility.ERROR:
                    other = ", ".join(ends - {own}) or own
                    given = reason.removeprefix("ERROR: ").rstrip(";").lower()
                    found[topic] = GraphFault(
                        f"incompatible QoS on {topic}",
                        f"given {given} ({other}), expected qualities of service that fit; no "
                        f"message passes; 'ros2 topic info -v {topic}' shows both sides",
                        severe=False,
                    )
        return list(found.values())


def full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of the node of an endpoint.

    It is `UNKNOWN` until the node is discovered, and `INVALID` where it announces no valid name.
    """
    if "UNKNOWN" in info.node_name:
        return UNKNOWN
    name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
    return name if _NAME.fullmatch(name) else INVALID


def further_publishers(
    pose_topic: str, poses: Sequence[str], clock_topic: str, clocks: Sequence[str]
) -> list[GraphFault]:
    """Return the faults of several nodes `clocks` or `poses` that publish clock or pose."""
    return [
        *several_publishers(clock_topic, clocks, "time jumps between them"),
        *several_publishers(pose_topic, poses, "the pose jumps between them"),
    ]


def several_publishers(topic: str, nodes: Sequence[str], effect: str) -> list[GraphFault]:
    """Return the fault of a topic that more than one of `nodes` publishes, with its effect."""
    if len(nodes) < 2:
        return []
    return [
        GraphFault(
            f"other publisher of {topic}",
            f"given {len(nodes)} ({names_of(nodes)}), expected one; {effect}; "
            f"{_USE_NAMESPACE}; {_KILLED}",
            severe=False,
        )
    ]


def names_of(nodes: Sequence[str]) -> str:
    """Return the names of nodes for a message, a few of them if there are many."""
    more = ["..."] if len(nodes) > _MOST_NAMES else []
    return ", ".join([*sorted(nodes)[:_MOST_NAMES], *more])


def network_fault(announced: Set[str], present: Set[str]) -> list[GraphFault]:
    """Return the fault of a node that other machines are not told the right address of.

    `announced` are the addresses of this machine when the node started, which Fast DDS announces
    as long as the node runs, `present` those that it has now.
    """
    if not present or announced & present:
        return []
    before, now = (", ".join(sorted(some)) or "none" for some in (announced, present))
    return [
        GraphFault(
            "network", f"given the address {now}, expected the one that this node announces since "
            f"its start ({before}); nodes on other machines cannot find it: restart it",
            severe=False,
        )
    ]
