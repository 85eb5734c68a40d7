# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Fault of a recorder that has nothing to record, as in another namespace than its robot."""

import time
from collections.abc import Sequence

from rclpy.node import Node

from sphere_nmpc.foreign_text import shown
from sphere_nmpc.ros.graph_monitor import GraphFault
from sphere_sim.recording.recorder_settings import DEFAULT_TOPICS, absolute, matches_any

_WITHIN = 5.0
"""Wall time within which nodes that start together find each other [s], on a busy machine too."""
_SHARED = frozenset(name for name in DEFAULT_TOPICS if name.startswith("/"))
"""Topics that all robots share: they have publishers whatever the namespace."""


class MissingTopics:
    """Search for a publisher of any of the topics to record, until there is one.

    Parameters
    ----------
    node : Node
        The recorder.
    names : sequence of str
        Names and patterns of the topics, those without a leading slash in its namespace.
    """

    def __init__(self, node: Node, names: Sequence[str]) -> None:
        self._node = node
        self._names = [name for name in names if name not in _SHARED]
        self._awaited = bool(self._names)
        self._due = time.monotonic() + _WITHIN

    def faults(self) -> list[GraphFault]:
        """Return the fault that none of the topics has a publisher, if that goes on."""
        if not self._awaited:
            return []
        node = self._node
        wanted = [absolute(name, node.get_namespace()) for name in self._names]
        published = [
            topic for topic, _ in node.get_topic_names_and_types() if node.count_publishers(topic)
        ]
        self._awaited = not any(matches_any(topic, wanted) for topic in published)
        if not self._awaited or time.monotonic() < self._due:
            return []
        more = " or its other topics" if len(wanted) > 1 else ""
        remedy = "start the robot or a simulator, or name its namespace, -r __ns:=/second"
        for name in self._names:
            others = [topic for topic in sorted(published) if topic.endswith(f"/{name}")]
            if others:
                namespace = others[0].removesuffix(f"/{name}") or "/"
                remedy = (
                    f"there is {', '.join(map(shown, others[:3]))}: start this node with "
                    f"-r __ns:={shown(namespace)}"
                )
                break
        given = f"given no publisher of {wanted[0]}{more}, expected one"
        return [GraphFault("nothing to record", f"{given}; {remedy}")]
