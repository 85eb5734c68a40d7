# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""All nodes of a robot in a world frame of another name, as with a map."""

import pytest

pytest.importorskip("viser")

from geometry_msgs.msg import PoseStamped, Vector3, Vector3Stamped
from nav_msgs.msg import Odometry, Path
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from visualization_msgs.msg import MarkerArray

from sphere_nmpc.model.state import make_state, state_error
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.messages import pose_from_ros, pose_to_ros
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.ros.viewer.markers import MarkerNode
from sphere_sim.ros.viewer.node import TopicSource
from sphere_sim.viewer.source import SetGoal

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
FIRST, SECOND, THIRD = (make_state((x, -3.0), UPRIGHT) for x in (1.0, 2.0, 3.0))
FRAME = "map"


def test_every_message_is_in_the_frame_that_is_set(graph) -> None:
    frame = Parameter("world_frame", value=FRAME)
    graph.add(SimulatorNode([frame]))
    controller = ControllerNode([frame, Parameter("use_sim_time", value=True)])
    graph.add(controller)
    graph.add(MarkerNode([frame]))
    viewer = Node("viewer")
    graph.add(viewer)
    source = TopicSource(viewer, FRAME)
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

    goals.publish(pose_to_ros(FIRST, 0, 0.3, FRAME))
    graph.until(lambda: reaches(FIRST))
    goals.publish(pose_to_ros(SECOND, 0, 0.3, "world"))
    graph.until(lambda: controller._fault_log.counts["goal_pose refused"] == 1)
    # A goal of the viewer is in whatever frame the controller has.
    graph.until(lambda: source.handle(SetGoal(THIRD)) == "" and reaches(THIRD))
    graph.publisher(Vector3, "simulator/push").publish(Vector3(x=0.1))
    graph.until(lambda: all(received.values()) and markers and len(markers[-1].markers) == 5)
    for topic, messages in received.items():
        assert {message.header.frame_id for message in messages} == {FRAME}, topic
    assert received["controller/predicted_path"][-1].poses[0].header.frame_id == FRAME
    assert {marker.header.frame_id for marker in markers[-1].markers} == {FRAME}
    graph.until(lambda: source.frames()[-1].state is not None)
