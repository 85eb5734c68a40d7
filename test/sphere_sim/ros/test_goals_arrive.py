# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals published as by ``ros2 topic pub``: they reach the controller."""

import subprocess
import sys
from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
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


@pytest.mark.slow
def test_goals_arrive_beside_all_other_nodes_and_an_echo(graph, tmp_path, monkeypatch) -> None:
    recorder = pytest.importorskip("sphere_sim.ros.recorder.node")
    viewer = pytest.importorskip("sphere_sim.ros.viewer.node")
    markers = pytest.importorskip("sphere_sim.ros.viewer.markers")
    monkeypatch.chdir(tmp_path)  # where the recorder begins a bag
    others = [recorder.RecorderNode(), viewer.ViewerNode(0), markers.MarkerNode()]
    for node in others:
        graph._executor.add_node(node)
    try:
        # All nodes share one thread here; at full pace it would have no time for a goal.
        graph.add(SimulatorNode([Parameter("real_time_factor", value=0.1)]))
        graph.add(ControllerNode([Parameter("use_sim_time", value=True)]))
        accepted = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
        for goal in (0.1, 0.2):  # --once, without another subscription
            send(graph, goal, 1)
            graph.until(lambda goal=goal: accepted and accepted[-1].pose.position.x == goal)
        graph.collect(PoseStamped, "goal_pose")
        send(graph, 0.3, 3)  # -t 3, as the documents print it
        graph.until(lambda: accepted[-1].pose.position.x == 0.3)
        assert 3 <= len(accepted) <= 5
    finally:
        for node in others:
            node.finish()
            node.destroy_node()
