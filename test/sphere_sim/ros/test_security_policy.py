# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Policy of config/sros2_policy.xml against the topics and services of the nodes."""

import contextlib
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter

from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_sim.ros.recorder.node import RecorderNode
from sphere_sim.ros.session.goal_command import ControllerStatus
from sphere_sim.ros.session.goal_sender import GoalSender
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.ros.viewer.markers import MarkerNode

ROOT = Path(__file__).parents[3]
POLICY = ROOT / "config" / "sros2_policy.xml"
RULES = (
    ("topics", "publish", "publisher"), ("topics", "subscribe", "subscriber"),
    ("services", "reply", "service"), ("services", "request", "client"),
)
"""Blocks and attributes of the policy, and the name of the same in the ROS graph."""
SOMETIMES = {"/tf", "/tf_static"}
"""Published only where tf2_msgs is installed and a subscription exists."""
OF_EVERY_NODE = re.compile(r"parameter|rosout|type_description")

Rows = dict[str, set[str]]
"""Full names by kind."""


def allowed() -> dict[str, Rows]:
    """Return what the policy allows to each node."""
    nodes = {}
    for profile in ElementTree.parse(POLICY).getroot().iter("profile"):
        name = profile.attrib["node"]
        nodes[name] = {
            kind: {full(e.text, name) for block in profile.findall(tag) if rule in block.attrib
                   for e in block}
            for tag, rule, kind in RULES
        }
    return nodes


def full(name: str, node: str) -> str:
    return name if name.startswith("/") else "/" + name.replace("~", node)


def opened(probe: Node, name: str) -> Rows:
    """Return what a node has opened, as others see it."""
    rows = {}
    for _, _, kind in RULES:
        try:
            found = getattr(probe, f"get_{kind}_names_and_types_by_node")(name, "/")
        except RuntimeError:  # not discovered yet
            found = []
        # The recorder requests parameters of all nodes, also of the probe.
        rows[kind] = {topic for topic, _ in found if not topic.startswith("/probe/")}
    return rows


def difference(probe: Node) -> dict[str, set[str]]:
    """Return what is allowed to each node and not opened, or the other way round."""
    found = {}
    for name, rows in allowed().items():
        own = opened(probe, name)
        apart = {entry for kind in rows for entry in rows[kind] ^ own[kind]} - SOMETIMES
        if apart:
            found[name] = apart
    return found


def test_policy_allows_what_the_nodes_open_and_nothing_else(graph, tmp_path, monkeypatch) -> None:
    viewer = pytest.importorskip("sphere_sim.ros.viewer.node")
    monkeypatch.chdir(tmp_path)  # where the recorder begins a bag
    simulated = Parameter("use_sim_time", value=True)
    most = {"plant": "rigid_body", "lockstep": True}
    graph.add(SimulatorNode([Parameter(name, value=value) for name, value in most.items()]))
    graph.add(ControllerNode([simulated]))
    followers = [RecorderNode(), MarkerNode(), viewer.ViewerNode(0)]
    for node in followers:
        node.set_parameters([simulated])
        graph._executor.add_node(node)
    goal = rclpy.create_node("goal")
    GoalSender(goal, lambda: None)
    ControllerStatus(goal, lambda: None)
    graph._executor.add_node(goal)
    apart: dict[str, set[str]] = {}

    def agree() -> bool:
        apart.clear()
        apart.update(difference(graph.probe))
        return not apart

    try:
        with contextlib.suppress(AssertionError):  # what differs is named below
            graph.until(agree)
        assert apart == {}
    finally:
        for node in followers:
            node.finish()
        for node in (*followers, goal):
            node.destroy_node()


def test_only_the_controller_subscribes_to_goals() -> None:
    # `ros2 topic pub --once` ends after the first matched subscription.
    takers = {name for name, rows in allowed().items() if "/goal_pose" in rows["subscriber"]}
    assert takers == {"controller"}


def test_document_has_the_tables_of_the_policy() -> None:
    text = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
    documented = {}
    for name, *cells in re.findall(r"^\| `(\w+)` \|(.*)\|(.*)\|(.*)\|(.*)\|$", text, re.MULTILINE):
        documented[name] = [
            {full(t, name) for t in re.findall(r"`([^`]+)`", cell)} for cell in cells
        ]
    assert documented == {
        name: [{t for t in row if not OF_EVERY_NODE.search(t)} for row in rows.values()]
        for name, rows in allowed().items()
    }


def test_each_node_has_an_enclave_of_its_own() -> None:
    enclaves = list(ElementTree.parse(POLICY).getroot().iter("enclave"))
    names = [next(e.iter("profile")).attrib["node"] for e in enclaves]
    assert [e.attrib["path"] for e in enclaves] == [f"/sphere_nmpc/{name}" for name in names]
    assert len(set(names)) == len(names)
