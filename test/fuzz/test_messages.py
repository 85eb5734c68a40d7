# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes under arbitrary messages: no callback raises, and commands keep the limits."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.messages import JOINT_NAMES, hold_and_stamp
from sphere_sim.faults.limits import LimitCheck
from sphere_sim.ros.simulator.node import SimulatorNode

NUMBERS = st.one_of(
    st.floats(), st.sampled_from([0.0, 1.0, -1.0, 0.5, math.sqrt(0.5), 1e6, 1e154, 5e-324])
)
SECONDS = st.one_of(st.integers(-(2**31), 2**31 - 1), st.integers(0, 3))
NANOSECONDS = st.one_of(st.integers(0, 2**32 - 1), st.integers(0, 10**9 - 1))
NAMES = st.lists(st.sampled_from([*JOINT_NAMES, "", "wheel", "\u00fc"]), max_size=3)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MANY = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])


@st.composite
def poses(draw) -> PoseStamped:
    message = PoseStamped()
    message.header.stamp.sec = draw(SECONDS)
    message.header.stamp.nanosec = draw(NANOSECONDS)
    message.header.frame_id = draw(st.sampled_from(["", "world", "map", "\u00fc" * 100]))
    place, turn = message.pose.position, message.pose.orientation
    place.x, place.y, place.z = (draw(NUMBERS) for _ in range(3))
    turn.x, turn.y, turn.z, turn.w = (draw(NUMBERS) for _ in range(4))
    if draw(st.booleans()):
        turn.x, turn.y, turn.z, turn.w = 0.6, 0.0, 0.0, 0.8
    return message


@st.composite
def trajectories(draw) -> JointTrajectory:
    message = JointTrajectory()
    message.header.stamp.sec = draw(SECONDS)
    message.header.stamp.nanosec = draw(NANOSECONDS)
    message.joint_names = list(JOINT_NAMES) if draw(st.booleans()) else draw(NAMES)
    for _ in range(draw(st.integers(0, 4))):
        point = JointTrajectoryPoint(velocities=draw(st.lists(NUMBERS, max_size=3)))
        point.time_from_start.sec = draw(SECONDS)
        point.time_from_start.nanosec = draw(NANOSECONDS)
        message.points.append(point)
    return message


@pytest.fixture
def controller(graph) -> ControllerNode:
    node = ControllerNode([Parameter("strategy", value="paper")])
    graph.add(node)
    return node


@pytest.fixture
def sent(controller, monkeypatch) -> LimitCheck:
    check = LimitCheck(100.0, 400.0)
    publish = controller._sender._trajectories.publish

    def check_and_publish(message) -> None:
        # Relative to the epoch, as times since 1970 would be rounded.
        hold, _ = hold_and_stamp(message, 0, controller._control_clock.epoch)
        check.trajectory(hold)
        publish(message)

    monkeypatch.setattr(controller._sender._trajectories, "publish", check_and_publish)
    return check


@MANY
@given(pose=poses(), goal=poses())
def test_any_pose_and_goal_leave_the_controller_within_its_limits(
    controller, sent, pose, goal
) -> None:
    sent.begin()
    controller._receive_goal(goal)
    controller._receive_pose(serialize_message(pose))
    controller._tick()
    assert not sent.broken


def test_poses_of_now_with_any_numbers_keep_the_limits(controller, sent) -> None:
    rng = np.random.default_rng(1)
    sent.begin()
    for _ in range(60):
        pose = PoseStamped()
        pose.header.stamp = controller.get_clock().now().to_msg()
        place, turn = pose.pose.position, pose.pose.orientation
        place.x, place.y = (float(v) for v in rng.choice([0.0, 1e-300, 5.0, -1e6, 1e5], 2))
        q = rng.normal(size=4)
        turn.x, turn.y, turn.z, turn.w = (float(v) for v in q / np.linalg.norm(q))
        controller._receive_pose(serialize_message(pose))
        controller._receive_goal(pose if rng.random() < 0.3 else PoseStamped())
        controller._tick()
    assert sent.worst_speed > 0.0, "plans were sent"
    assert not sent.broken


@MANY
@given(trajectory=trajectories(), data=st.lists(NUMBERS, max_size=4))
def test_any_command_leaves_the_robot_within_its_limits(graph, trajectory, data) -> None:
    node = getattr(graph, "simulator", None)
    if node is None:
        node = graph.simulator = SimulatorNode([Parameter("start_paused", value=True)])
        graph.add(node)
    node._receiver._receive_trajectory(serialize_message(trajectory))
    node._receiver._receive_speeds(serialize_message(Float64MultiArray(data=data)))
    before = np.array(node.simulator.speed_reference)
    for _ in range(3):
        node._advance()
    after = node.simulator.speed_reference
    assert np.all(np.isfinite(node.simulator.plant.state))
    assert np.all(np.abs(after) <= 100.0) and np.all(np.abs(after - before) <= 3 * 4.0 + 1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_nodes_keep_the_limits_and_still_work_after_invalid_bytes(
    graph, controller, seed
) -> None:
    rng = np.random.default_rng(seed)
    accepted = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
    whole = {
        "pose": PoseStamped(),
        "goal_pose": PoseStamped(),
        "rotor_trajectory": JointTrajectory(
            joint_names=list(JOINT_NAMES), points=[JointTrajectoryPoint(velocities=[1.0, 2.0])]
        ),
    }
    simulator = SimulatorNode([Parameter("start_paused", value=True)])
    graph.add(simulator)
    for topic, message in whole.items():
        sender = graph.publisher(type(message), topic)
        data = serialize_message(message)
        for i in range(30):
            damaged = bytearray(data)
            if i % 2:
                damaged = damaged[: rng.integers(1, len(data))]
            else:
                for place in rng.integers(4, len(data), size=4):
                    damaged[place] = rng.integers(256)
            sender.publish(bytes(damaged))
            graph.spin()
    assert np.all(np.isfinite(simulator.simulator.plant.state))
    assert np.all(np.abs(simulator.simulator.speed_reference) <= 100.0)
    goal = PoseStamped()
    goal.pose.position.x = 1.25
    graph.publisher(PoseStamped, "goal_pose").publish(goal)
    graph.until(lambda: accepted and accepted[-1].pose.position.x == 1.25)
