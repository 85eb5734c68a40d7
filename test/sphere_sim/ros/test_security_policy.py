# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""config/sros2_policy.xml allows what the nodes really open, and docs/security.md tells it."""

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
from sphere_sim.ros.session.goal_sender import GoalSender
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.ros.viewer.markers import MarkerNode

ROOT = Path(__file__).parents[3]
POLICY = ROOT / "config" / "sros2_policy.xml"
RULES = (
    ("topics", "publish", "publisher"), ("topics", "subscribe", "subscriber"),
    ("services", "reply", "service"), ("services", "request", "client"),
)
"""Of the policy, and what the graph calls the same."""
SOMETIMES = {"/tf", "/tf_static"}
"""Where tf2_msgs is installed, and somebody listens."""
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
        # The recorder asks everybody for parameters, the probe too.
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


def test_policy_is_what_the_nodes_open(graph, tmp_path, monkeypatch) -> None:
    viewer = pytest.importorskip("sphere_sim.ros.viewer.node")
    monkeypatch.chdir(tmp_path)  # where the recorder begins a bag
    simulated = Parameter("use_sim_time", value=True)
    graph.add(SimulatorNode([Parameter("plant", value="rigid_body")]))
    graph.add(ControllerNode([simulated]))
    followers = [RecorderNode(), MarkerNode(), viewer.ViewerNode(0)]
    for node in followers:
        node.set_parameters([simulated])
        graph._executor.add_node(node)
    goal = rclpy.create_node("goal")
    GoalSender(goal, lambda: None)
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


def test_nobody_but_the_controller_subscribes_to_goals() -> None:
    # Who sends a goal with `ros2 topic pub --once` leaves after the first subscription.
    takers = {name for name, rows in allowed().items() if "/goal_pose" in rows["subscriber"]}
    assert takers == {"controller"}


def test_document_tells_the_policy() -> None:
    text = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
    told = {}
    for name, *cells in re.findall(r"^\| `(\w+)` \|(.*)\|(.*)\|(.*)\|(.*)\|$", text, re.MULTILINE):
        told[name] = [{full(t, name) for t in re.findall(r"`([^`]+)`", cell)} for cell in cells]
    assert told == {
        name: [{t for t in row if not OF_EVERY_NODE.search(t)} for row in rows.values()]
        for name, rows in allowed().items()
    }


def test_each_node_has_an_enclave_of_its_own() -> None:
    enclaves = list(ElementTree.parse(POLICY).getroot().iter("enclave"))
    names = [next(e.iter("profile")).attrib["node"] for e in enclaves]
    assert [e.attrib["path"] for e in enclaves] == [f"/sphere_nmpc/{name}" for name in names]
    assert len(set(names)) == len(names)
