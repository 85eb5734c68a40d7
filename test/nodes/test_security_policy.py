# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The policy of SROS 2 allows what the nodes open, and is that of the document."""

import contextlib
import re
from pathlib import Path
from xml.etree import ElementTree

import navigation_messages
import pytest
import rclpy
from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Goals
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node

from sphere_nmpc.control.goal_client import NavigatorSettings
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.goal_link import GoalLink
from sphere_nmpc.ros.navigator.node import NavigatorNode
from sphere_nmpc.ros.navigator.substitutes import ACTIONS, SERVICES
from sphere_nmpc.ros.odometry.node import OdometryNode
from sphere_sim.ros.recorder.node import RecorderNode
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.ros.viewer.markers import MarkerNode

ROOT = Path(__file__).parents[2]
RULES = (
    ("topics", "publish", "publisher"), ("topics", "subscribe", "subscriber"),
    ("services", "reply", "service"), ("services", "request", "client"),
)
"""Blocks and attributes of the policy, and the name of the same in the ROS graph."""
OF_ACTION = {
    "publisher": ("feedback", "status"), "service": ("send_goal", "cancel_goal", "get_result"),
}
"""What the server of an action opens."""
SOMETIMES = {
    "/tf", "/tf_static", "/ground_truth/pose", "/ground_truth/odom",
    "/odometry/status", "/odometry/reset", *(f"/{name}" for name in SERVICES),
    *(f"/{name}/_action/{part}" for name in ACTIONS for part in sum(OF_ACTION.values(), ())),
}
"""Opened only where the types are installed (tf2_msgs, all of nav2_msgs), where a subscription
exists, with odometry, or while there are no poses."""
WITH_ODOMETRY = {"simulator": {"/pose"}}
"""Opened by a node only with odometry, which others open in any case."""
Rows = dict[str, set[str]]
"""Full names by kind."""


def allowed() -> dict[str, Rows]:
    """Return what the policy allows to each node."""
    nodes = {}
    for profile in ElementTree.parse(ROOT / "config" / "sros2_policy.xml").iter("profile"):
        name = profile.attrib["node"]
        nodes[name] = {
            kind: {full(e.text, name) for block in profile.findall(tag) if rule in block.attrib
                   for e in block}
            for tag, rule, kind in RULES
        }
        for action in (e.text for e in profile.iter("action")):
            for kind, parts in OF_ACTION.items():
                nodes[name][kind] |= {f"/{action}/_action/{part}" for part in parts}
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


def test_policy_allows_what_the_nodes_open_and_nothing_else(graph, tmp_path, monkeypatch) -> None:
    viewer = pytest.importorskip("sphere_sim.ros.viewer.node")
    monkeypatch.chdir(tmp_path)  # where the recorder begins a bag
    graph.start(SimulatorNode, plant="rigid_body", lockstep=True)
    graph.start(ControllerNode, use_sim_time=True)
    navigation_messages.provide()
    followers = [RecorderNode(), MarkerNode(), viewer.ViewerNode(0), NavigatorNode(),
                 OdometryNode()]
    goal = rclpy.create_node("goal")
    kinds = PoseStamped, PointStamped, Goals, PathMessage
    GoalLink(goal, kinds, NavigatorSettings(), lambda ending: None)
    graph._executor.add_node(goal)
    for node in followers:
        node.set_parameters([rclpy.Parameter("use_sim_time", value=True)])
        graph._executor.add_node(node)
    apart: dict[str, set[str]] = {}

    def agree() -> bool:
        apart.clear()
        for name, rows in allowed().items():
            own = opened(graph.probe, name)
            differ = {entry for kind in rows for entry in rows[kind] ^ own[kind]}
            if found := differ - SOMETIMES - WITH_ODOMETRY.get(name, set()):
                apart[name] = found
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
    # `ros2 topic pub --once` ends after the first matched subscription.
    goals = {"/goal_pose", "/goal_point", "/goals", "/path"}
    takers = {name for name, rows in allowed().items() if goals & rows["subscriber"]}
    assert takers == {"controller"}


def test_document_has_the_tables_of_the_policy() -> None:
    text = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
    documented = {
        name: [{full(t, name) for t in re.findall(r"`([^`]+)`", cell)} for cell in cells]
        for name, *cells in re.findall(r"^\| `(\w+)` \|(.*)\|(.*)\|(.*)\|(.*)\|$", text, re.M)
    }
    not_listed = re.compile(r"parameter|rosout|type_description|_action/")
    assert documented == {
        name: [{t for t in row if not not_listed.search(t)} for row in rows.values()]
        for name, rows in allowed().items()
    }
