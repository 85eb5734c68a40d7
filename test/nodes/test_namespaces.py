# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Frames and namespaces: a world frame of another name, and two robots beside each other."""

import re

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Vector3, Vector3Stamped
from nav_msgs.msg import Odometry, Path
from rclpy.node import Node
from ros_graph import started
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from visualization_msgs.msg import MarkerArray

from sphere_nmpc.model.state import as_state, make_state, state_error
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_from_ros, pose_to_ros
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.viewer.source import SetGoal

SECOND = ("-r", "__ns:=/second")
FOLLOW = {"use_sim_time": True}
GOALS = ([1.5, -2.5, 1, 0, 0, 0], [2.5, -3.5, 0, 1, 0, 0])


@pytest.mark.slow
def test_robot_in_a_namespace_is_one_of_its_own_and_both_reach_their_goals(graph) -> None:
    prefixes = ("", "second/")
    arrivals = [graph.collect(Bool, f"{prefix}controller/at_goal", LATCHED) for prefix in prefixes]
    poses = [graph.collect(PoseStamped, f"{prefix}pose") for prefix in prefixes]
    clock, odometry = graph.collect(Clock, "second/clock"), graph.collect(Odometry, "second/odom")
    reports = graph.collect(DiagnosticArray, "/diagnostics")

    def reported() -> set[str]:
        return {status.name for report in reports for status in report.status}

    with started("simulator"), started("simulator", *SECOND):
        graph.until(lambda: clock and all(poses))
        with started("controller", **FOLLOW) as first, started(
            "controller", *SECOND, **FOLLOW
        ) as second:
            for prefix, goal in zip(prefixes, GOALS, strict=True):
                graph.send_goal(as_state(np.array(goal, float)), topic=f"{prefix}goal_pose")
            graph.until(lambda: odometry and len(reported()) == 8)
            graph.until(lambda: all(received and received[-1].data for received in arrivals))
            graph.until(
                lambda: all(
                    state_error(pose_from_ros(received[-1]), np.array(goal, float)) < 1e-2
                    for received, goal in zip(poses, GOALS, strict=True)
                )
            )
            assert graph.probe.count_publishers("/clock") == 1
            for node in (first, second):
                assert not re.search("clock jumped|other publisher", node.output)
    assert odometry[-1].child_frame_id == "second/base_link"
    own = {"simulator: clock", "simulator: commands", "controller: solver", "controller: loop"}
    assert reported() == own | {f"second/{name}" for name in own}


def test_every_message_is_in_the_frame_that_is_set(graph) -> None:
    markers_module = pytest.importorskip("sphere_sim.ros.viewer.markers")
    viewer_module = pytest.importorskip("sphere_sim.ros.viewer.node")
    places = [make_state((x, -3.0), (1.0, 0.0, 0.0, 0.0)) for x in (1.0, 2.0, 3.0)]
    graph.start(SimulatorNode, world_frame="map")
    controller = graph.start(ControllerNode, world_frame="map", use_sim_time=True)
    graph.start(markers_module.MarkerNode, world_frame="map")
    viewer = Node("viewer")
    graph.add(viewer)
    source = viewer_module.TopicSource(viewer, "map")
    received = {
        topic: graph.collect(kind, topic, qos)
        for topic, kind, qos in (
            ("pose", PoseStamped, 10), ("odom", Odometry, 10),
            ("simulator/pushed", Vector3Stamped, 10),
            ("controller/active_goal", PoseStamped, LATCHED),
            ("controller/predicted_path", Path, 10),
        )
    }
    markers = graph.collect(MarkerArray, "markers")
    goals = graph.publisher(PoseStamped, "goal_pose")

    def reaches(goal) -> bool:
        accepted = received["controller/active_goal"]
        return bool(accepted) and state_error(pose_from_ros(accepted[-1]), goal) < 1e-9

    goals.publish(pose_to_ros(places[0], 0, 0.3, "map"))
    graph.until(lambda: reaches(places[0]))
    goals.publish(pose_to_ros(places[1], 0, 0.3, "world"))
    graph.until(lambda: controller._fault_log.counts["goal_pose refused"] == 1)
    # A goal of the viewer is in whatever frame the controller has.
    graph.until(lambda: source.handle(SetGoal(places[2])) == "" and reaches(places[2]))
    graph.send("simulator/push", Vector3(x=0.1))
    graph.until(lambda: all(received.values()) and markers and len(markers[-1].markers) == 5)
    for topic, messages in received.items():
        assert {message.header.frame_id for message in messages} == {"map"}, topic
    assert received["controller/predicted_path"][-1].poses[0].header.frame_id == "map"
    assert {marker.header.frame_id for marker in markers[-1].markers} == {"map"}
    graph.until(lambda: source.frames()[-1].state is not None)
