# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Who else is in a domain: nodes whose clock, poses or commands would mix with one's own.

``python -m sphere_sim.ros.session.domain_guests NAMESPACE TOPIC ...`` prints their names, for a
process that must not start ROS itself; exit code 0 says that there
are none, 3 that there are some.
"""

import argparse
import os
import sys
import time
from collections.abc import Sequence

import rclpy
from rclpy.node import Node

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.environment import DOMAIN
from sphere_nmpc.ros.graph_monitor import UNKNOWN, full_name
from sphere_nmpc.ros.loopback import apply_localhost_only
from sphere_nmpc.ros.startup import start_ros

TOPICS = ("clock", "pose", "rotor_trajectory", "rotor_commands")
"""What only one robot of a namespace may publish."""
_LOOKS = {True: (0.6,), False: (0.4,) * 5}
"""How long each look takes [s], over the loopback alone and otherwise.

Over the loopback nodes were found within 0.4 s in each of 100 tries. With ROS's own transports a
participant finds them within 0.3 s, or else after the 3 s between two announcements of Fast DDS;
of 30 participants 18 were quick, so that a new one has the better chances than a long look.
"""
_NAMES = 0.2
"""How long to go on looking once somebody is found, for all to be named [s]."""
_LOOK_EVERY = 0.02
FOUND = 3
"""Exit code of the look where somebody was found."""


class DomainTakenError(SphereNmpcError):
    """Somebody in the domain publishes what one's own nodes are to publish.

    Parameters
    ----------
    who : list of str
        Full names of the nodes that were found.
    """

    def __init__(self, who: list[str]) -> None:
        domain = os.environ.get(DOMAIN) or "0"
        super().__init__(
            f"{DOMAIN}: given {domain}, where others already run ({', '.join(who)}), expected a "
            "domain without a simulator, controller or demo, as clocks and commands would mix; "
            f"unset {DOMAIN} to take a free domain, set another number, or end what runs there"
        )


def look_for_guests(namespace: str = "/", topics: Sequence[str] = TOPICS) -> list[str]:
    """Return the full names of the nodes in this domain that publish a robot's topics.

    rclpy must not be in use.

    Parameters
    ----------
    namespace : str, optional
        Of the robot.
    topics : sequence of str, optional
        What is looked for.
    """
    looks = _LOOKS[apply_localhost_only()]
    return next(filter(None, (_look(namespace, topics, seconds) for seconds in looks)), [])


def _look(namespace: str, topics: Sequence[str], seconds: float) -> list[str]:
    start_ros([], quiet=True)
    try:
        node = rclpy.create_node("lookout", namespace=namespace, start_parameter_services=False)
        try:
            end, found = time.monotonic() + seconds, False
            while (now := time.monotonic()) < end:
                if not found and any(publishers(node, topics).values()):
                    found, end = True, now + _NAMES
                time.sleep(_LOOK_EVERY)
            return _names(publishers(node, topics))
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


def refuse_company(node: Node) -> None:
    """Raise if a topic of one's own nodes has a publisher besides them.

    Parameters
    ----------
    node : Node
        Sees the graph, in the namespace of one's own nodes, which are all up.

    Raises
    ------
    DomainTakenError
        If so, as when two demos begin at the same moment.
    """
    crowded = {topic: who for topic, who in publishers(node).items() if len(who) > 1}
    if crowded:
        raise DomainTakenError(_names(crowded))


def publishers(node: Node, topics: Sequence[str] = TOPICS) -> dict[str, list[str]]:
    """Return for each topic the full names of the nodes that publish it, one an endpoint."""
    return {
        topic: [
            full_name(info)
            for info in node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
        ]
        for topic in topics
    }


def _names(found: dict[str, list[str]]) -> list[str]:
    """Return who was found, twice where two of one name publish the same."""
    number = {name: max(who.count(name) for who in found.values())
              for name in {name for who in found.values() for name in who}}
    named = {name: times for name, times in number.items() if name != UNKNOWN} or number
    return sorted(name for name, times in named.items() for _ in range(times))


def main() -> int:
    """Look, print the names in one line and return the exit code."""
    parser = argparse.ArgumentParser(description="Tell who publishes topics of a robot.")
    parser.add_argument("namespace")
    parser.add_argument("topics", nargs="+")
    given = parser.parse_args()
    try:
        who = look_for_guests(given.namespace, given.topics)
    except SphereNmpcError as error:
        print(error, file=sys.stderr)
        return 1
    print(", ".join(who))
    return FOUND if who else 0


if __name__ == "__main__":
    sys.exit(main())
