# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Looking at a node's surroundings, and telling once what is wrong there."""

from collections.abc import Sequence
from itertools import product

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo

from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.ros.surroundings import Complaint, incompatible, rivals

_CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
"""For subscriptions whose incompatible publishers a `Watch` tells, rather than rclpy too."""
UNKNOWN = "a node that was just found"
"""Stands for the name of a node of which the graph knows only a topic yet."""
_OF_EVERY_NODE = {"/rosout", "/parameter_events"}


class Watch:
    """Keep what is wrong, log each thing once when it begins, and say when it is over.

    Parameters
    ----------
    node : Node
        The node whose surroundings these are.
    faults : FaultLog
        Who writes and counts.
    """

    def __init__(self, node: Node, faults: FaultLog) -> None:
        self._node = node
        self._faults = faults
        self.complaints: list[Complaint] = []
        """What is wrong now, the gravest first."""

    def update(self, found: Sequence[Complaint]) -> None:
        """Take note of what is wrong now, and log what is new."""
        before = {complaint.kind for complaint in self.complaints}
        self.complaints = list(found)
        for complaint in found:
            if complaint.kind not in before:
                self._faults.report(complaint.kind, complaint.message)
        for kind in before - {complaint.kind for complaint in found}:
            self._node.get_logger().info(f"{kind}: over")

    def publishers(self, topic: str) -> list[str]:
        """Return the full names of the nodes that publish a topic, one an endpoint."""
        return [full_name(info) for info in self._node.get_publishers_info_by_topic(topic)]

    def rivals(self, clocked: bool) -> list[Complaint]:
        """Return the complaints about further publishers of the pose, and if asked the clock."""
        pose, clock = map(self._node.resolve_topic_name, ("pose", "/clock"))
        clocks = self.publishers(clock) if clocked else []
        return rivals(pose, self.publishers(pose), clock, clocks)

    def clock_topics(self) -> list[str]:
        """Return the topics on which somebody publishes a clock."""
        return [
            topic for topic, kinds in self._node.get_topic_names_and_types()
            if _CLOCK_TYPE in kinds and self._node.count_publishers(topic) > 0
        ]

    def incompatible(self) -> list[Complaint]:
        """Return the complaints about publishers and subscriptions whose messages cannot pass."""
        node, own = self._node, self._node.get_fully_qualified_name()
        topics = {end.topic_name for end in node.subscriptions}
        topics |= {end.topic_name for end in node.publishers}
        found = {}
        for topic in sorted(topics - _OF_EVERY_NODE):
            # As the graph knows them: a node's own profiles leave open what the middleware fills.
            publishers = node.get_publishers_info_by_topic(topic)
            subscribers = node.get_subscriptions_info_by_topic(topic) if publishers else []
            for publisher, subscriber in product(publishers, subscribers):
                ends = {full_name(publisher), full_name(subscriber)}
                if own not in ends or topic in found:
                    continue
                fit, reason = qos_check_compatible(publisher.qos_profile, subscriber.qos_profile)
                if fit == QoSCompatibility.ERROR:
                    other = ", ".join(ends - {own}) or own
                    found[topic] = incompatible(topic, other, reason)
        return list(found.values())


def full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of an endpoint's node, of which the graph may not know it yet."""
    if "UNKNOWN" in info.node_name:
        return UNKNOWN
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"
