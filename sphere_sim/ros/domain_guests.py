# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Who else is in a domain: nodes whose clock, poses or commands would mix with one's own."""

import os
import time

import rclpy
from rclpy.node import Node

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.environment import DOMAIN
from sphere_nmpc.ros.joining import join
from sphere_nmpc.ros.watch import UNKNOWN, full_name

TOPICS = ("clock", "pose", "rotor_trajectory", "rotor_commands")
"""What only one robot of a namespace may publish."""
_LOOK = 0.6
"""How long to look [s]; over the loopback nodes were found within 0.4 s in each of 100 tries."""
_NAMES = 0.2
"""How long to go on looking once somebody is found, for all to be named [s]."""
_LOOK_EVERY = 0.02


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


def look_for_guests() -> list[str]:
    """Return the full names of the nodes in this domain that publish a robot's topics.

    It takes as long as nodes of this machine need to be found; rclpy must not be in use.
    """
    join([], quiet=True)
    try:
        node = rclpy.create_node("lookout", start_parameter_services=False)
        try:
            end, found = time.monotonic() + _LOOK, False
            while (now := time.monotonic()) < end:
                if not found and any(publishers(node).values()):
                    found, end = True, now + _NAMES
                time.sleep(_LOOK_EVERY)
            return _names(publishers(node))
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


def publishers(node: Node) -> dict[str, list[str]]:
    """Return for each topic the full names of the nodes that publish it, one an endpoint."""
    return {
        topic: [
            full_name(info)
            for info in node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
        ]
        for topic in TOPICS
    }


def _names(found: dict[str, list[str]]) -> list[str]:
    """Return who was found, twice where two of one name publish the same."""
    number = {name: max(who.count(name) for who in found.values())
              for name in {name for who in found.values() for name in who}}
    named = {name: times for name, times in number.items() if name != UNKNOWN} or number
    return sorted(name for name, times in named.items() for _ in range(times))
