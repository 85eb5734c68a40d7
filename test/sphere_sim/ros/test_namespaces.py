# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Two robots beside each other: clock, frames, names and goals of a namespace."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import started
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool

from sphere_nmpc.model.state import as_state, state_error
from sphere_nmpc.ros.messages import pose_from_ros, pose_to_ros

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SECOND = ("-r", "__ns:=/second")
FOLLOW = ("-p", "use_sim_time:=true")
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
        with started("controller", *FOLLOW) as first, started(
            "controller", *FOLLOW, *SECOND
        ) as second:
            for prefix, goal in zip(prefixes, GOALS, strict=True):
                message = pose_to_ros(as_state(np.array(goal, float)), 0, 0.3)
                graph.publisher(PoseStamped, f"{prefix}goal_pose").publish(message)
            graph.until(lambda: odometry and len(reported()) == 8)
            graph.until(lambda: all(received and received[-1].data for received in arrivals))
            graph.until(
                lambda: all(
                    state_error(pose_from_ros(received[-1]), np.array(goal, float)) < 1e-2
                    for received, goal in zip(poses, GOALS, strict=True)
                )
            )
            assert graph.probe.count_publishers("/clock") == 1
    assert odometry[-1].child_frame_id == "second/base_link"
    own = {"simulator: clock", "simulator: commands", "controller: solver", "controller: loop"}
    assert reported() == own | {f"second/{name}" for name in own}
    for node in (first, second):
        output = node.stderr.read()
        assert "clock jumped" not in output and "other publisher" not in output
