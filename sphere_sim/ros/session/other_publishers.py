# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Other publishers in a domain, whose clock, poses or commands would mix with those of our nodes.

`main` is the program of a child process, for a process that must not start ROS itself.
"""

import argparse
import os
import sys
import time
from collections.abc import Iterable, Sequence

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.graph_monitor import (
    NAMED_WITHIN,
    UNKNOWN,
    full_name,
    names_of,
    publishers_of,
)
from sphere_nmpc.ros.network import DOMAIN, apply_localhost_only
from sphere_nmpc.ros.startup import start_ros

TOPICS = {
    "clock": Clock, "pose": PoseStamped, "rotor_trajectory": JointTrajectory,
    "rotor_commands": Float64MultiArray,
}
"""Topics that have one publisher in each namespace, with their types."""
_SEARCHES = {True: (0.6,), False: (0.4,) * 5}
"""Duration of each search [s], over the loopback alone (True) and otherwise (False).

Over the loopback nodes were found within 0.4 s in each of 100 tries. With ROS's own transports a
participant finds them within 0.3 s, or else after the 3 s between two announcements of Fast DDS;
of 30 participants 18 were quick, so that several participants are better than a long search.
"""
_NAMES = 0.2
"""How long a search continues after its first publisher was found, to find all [s]."""
_PERIOD = 0.02
FOUND = 3
"""Exit code where publishers were found."""


class DomainInUseError(SphereNmpcError):
    """Other nodes, with these full names, publish in the domain what ours are to publish."""

    def __init__(self, nodes: list[str]) -> None:
        domain = os.environ.get(DOMAIN) or "0"
        super().__init__(
            f"{DOMAIN}: given {domain}, where others already run ({names_of(nodes)}), expected a "
            "domain without a simulator, controller or demo, as clocks and commands would mix; "
            f"unset {DOMAIN} to take a free domain, set another number, or end what runs there"
        )


def find_publishers(namespace: str = "/", topics: Iterable[str] = TOPICS) -> list[str]:
    """Return the full names of the nodes in this domain that publish topics of a robot.

    rclpy must not be in use.
    """
    searches = _SEARCHES[apply_localhost_only()]
    return next(filter(None, (_search(namespace, topics, seconds) for seconds in searches)), [])


def _search(namespace: str, topics: Iterable[str], seconds: float) -> list[str]:
    start_ros([], quiet=True)
    try:
        node = rclpy.create_node("search", namespace=namespace, start_parameter_services=False)
        try:
            found: dict[str, list[str]] = {}
            end = named = time.monotonic() + seconds
            while (now := time.monotonic()) < (
                named if any(UNKNOWN in nodes for nodes in found.values()) else end
            ):
                seen = publishers(node, topics)
                if any(seen.values()) and not any(found.values()):
                    end, named = now + _NAMES, now + NAMED_WITHIN
                found = seen
                time.sleep(_PERIOD)
            return _names(found)
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


def require_sole_publishers(node: Node) -> None:
    """Raise `DomainInUseError` if a topic has several publishers, as of two demos that start.

    The nodes of the robot in the namespace of `node` are all up.
    """
    crowded = {topic: nodes for topic, nodes in publishers(node).items() if len(nodes) > 1}
    if crowded:
        raise DomainInUseError(_names(crowded))


def publishers(node: Node, topics: Iterable[str] = TOPICS) -> dict[str, list[str]]:
    """Return for each topic the full names of the nodes that publish it, one an endpoint."""
    return {
        topic: [
            full_name(info)
            for info in publishers_of(node, topic, TOPICS[topic])
        ]
        for topic in topics
    }


def _names(found: dict[str, list[str]]) -> list[str]:
    """Return the names of the nodes; twice where two nodes of one name publish the same topic."""
    number = {name: max(nodes.count(name) for nodes in found.values())
              for name in {name for nodes in found.values() for name in nodes}}
    named = {name: times for name, times in number.items() if name != UNKNOWN} or number
    return sorted(name for name, times in named.items() for _ in range(times))


def main(argv: Sequence[str]) -> int:
    """Print the names in one line for ``NAMESPACE TOPIC ...``; return `FOUND`, or 0 for none."""
    parser = argparse.ArgumentParser(description="Print the nodes that publish topics of a robot.")
    parser.add_argument("namespace")
    parser.add_argument("topics", nargs="+", choices=TOPICS)
    given = parser.parse_args(argv)
    try:
        nodes = find_publishers(given.namespace, given.topics)
    except SphereNmpcError as error:
        print(error, file=sys.stderr)
        return 1
    print(names_of(nodes))
    return FOUND if nodes else 0
