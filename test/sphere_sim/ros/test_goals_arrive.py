# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals published as by ``ros2 topic pub``: they reach the controller."""

import subprocess
import sys
from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile

from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_sim.ros.simulator.node import SimulatorNode

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SENDER = Path(__file__).parents[3] / "bench" / "topic_pub.py"
"""Publishes as ``ros2 topic pub`` does."""


def send(graph, goal: float, times: int) -> None:
    # On a busy machine these nodes take longer to receive than the 0.1 s for which the tool stays.
    keep_alive = str(PATIENCE)
    process = subprocess.Popen([sys.executable, SENDER, str(goal), str(times), keep_alive])
    try:
        graph.until(lambda: process.poll() is not None)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0


@pytest.fixture
def other_nodes(graph, tmp_path, monkeypatch) -> list[Node]:
    """All other nodes of the package that users run beside simulator and controller."""
    recorder = pytest.importorskip("sphere_sim.ros.recorder.node")
    viewer = pytest.importorskip("sphere_sim.ros.viewer.node")
    markers = pytest.importorskip("sphere_sim.ros.viewer.markers")
    monkeypatch.chdir(tmp_path)  # where the recorder begins a bag
    nodes = [recorder.RecorderNode(), viewer.ViewerNode(0), markers.MarkerNode()]
    for node in nodes:
        graph._executor.add_node(node)
    yield nodes
    for node in nodes:
        node.finish()
        node.destroy_node()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("times", "echoes", "goals"), [(1, False, [0.1, 0.2, 0.3, 0.4]), (3, True, [0.1])],
    ids=["--once beside recorder, viewer and markers", "-t 3, as printed, beside an echo too"],
)
def test_goal_that_is_sent_arrives(graph, other_nodes, times, echoes, goals) -> None:
    # All nodes share one thread here; at full pace it would have no time for a goal.
    graph.add(SimulatorNode([Parameter("real_time_factor", value=0.1)]))
    graph.add(ControllerNode([Parameter("use_sim_time", value=True)]))
    accepted = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
    if echoes:
        graph.collect(PoseStamped, "goal_pose")
    for goal in goals:
        send(graph, goal, times)
        graph.until(lambda goal=goal: accepted and accepted[-1].pose.position.x == goal)
    assert len(goals) <= len(accepted) <= len(goals) * times
