# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of msg_docs/topics.md against the topics and services of the nodes."""

import re
from pathlib import Path

import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.subscription import Subscription

from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_sim.ros.simulator.node import SimulatorNode

DOCUMENT = Path(__file__).parents[3] / "msg_docs" / "topics.md"
CLASSES = {"simulator": SimulatorNode, "controller": ControllerNode}
ELSEWHERE = ("/rosout", "/parameter_events", "/tf")
"""Topics of rclpy, and one that depends on what is installed."""
ROW = re.compile(r"^\| `(\S+)` \| (\S+) \| (\w+) \| ([^|]*)\|", re.MULTILINE)


def documented(node: str) -> set[tuple[str, str, str, str]]:
    """Return (full name, type, kind, QoS) of each row in the section of a node."""
    section = DOCUMENT.read_text().split(f"\n## `{node}`\n")[1].split("\n## ")[0]
    return {
        (resolved(name, node), kind_of_message, kind, qos.strip())
        for name, kind_of_message, kind, qos in ROW.findall(section)
    }


def resolved(name: str, node: str) -> str:
    return name if name.startswith("/") else "/" + name.replace("~", node)


def type_name(message) -> str:
    package, kind, _ = message.__module__.split(".")
    return f"{package}/{kind}/{message.__name__}"


def offered(node) -> set[tuple[str, str, str, str]]:
    rows = set()
    for end in (*node.publishers, *node.subscriptions):
        if end.topic_name in ELSEWHERE:
            continue
        profile = end.qos_profile
        parts = [
            "reliable" if profile.reliability == ReliabilityPolicy.RELIABLE else "best effort",
            str(profile.depth),
        ]
        if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            parts.append("transient local")
        kind = "subscribes" if isinstance(end, Subscription) else "publishes"
        rows.add((end.topic_name, type_name(end.msg_type), kind, ", ".join(parts)))
    for service in node.services:
        if "parameter" not in service.service_name:
            name = service.service_name
            rows.add((name, type_name(service.srv_type), "service", ""))
    return rows


@pytest.mark.parametrize("name", CLASSES)
def test_tables_agree_with_the_node(graph, name) -> None:
    node = CLASSES[name]()
    graph.add(node)
    own = {row for row in offered(node) if "type_description" not in row[0]}
    assert own == documented(name)


@pytest.mark.parametrize("name", CLASSES)
@pytest.mark.parametrize("graph", [["--ros-args", "-r", "__ns:=/second"]], indirect=True)
def test_a_namespace_precedes_all_names_but_those_of_every_robot(graph, name) -> None:
    node = CLASSES[name]()
    graph.add(node)
    shared = {"/clock", "/diagnostics"}
    expected = {topic if topic in shared else f"/second{topic}" for topic, *_ in documented(name)}
    assert {topic for topic, *_ in offered(node) if "type_description" not in topic} == expected
