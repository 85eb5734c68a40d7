# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the graph around a controller that follows a simulated clock which has stopped."""

import pytest
from rclpy.topic_endpoint_info import TopicEndpointInfo

from sphere_nmpc.ros.graph_faults import (
    SILENCE_LIMIT,
    GraphState,
    find_faults,
    several_publishers,
)
from sphere_nmpc.ros.graph_monitor import INVALID, UNKNOWN, full_name

LONG = 10.0 * SILENCE_LIMIT


@pytest.mark.parametrize(
    ("pose_silence", "pose_age", "kinds"),
    [(0.1, 0.0, []), (0.1, -5.0, ["clock stopped"]), (LONG, 0.0, ["clock stopped"])],
    ids=["paused", "no clock messages", "ended"],
)
def test_stopped_clock_is_a_fault_unless_the_simulator_repeats_its_last_pose(
    pose_silence, pose_age, kinds
) -> None:
    state = GraphState(
        follows_clock=True, time=3.0, clock_silence=LONG, pose_silence=pose_silence,
        pose_age=pose_age, pose_timeout=0.5, clocks=["/simulator"], poses=["/simulator"],
    )
    assert [fault.kind for fault in find_faults(state)] == kinds


@pytest.mark.parametrize(
    ("namespace", "name", "shown"),
    [
        ("/", "robot_1", "/robot_1"),
        ("/left", "robot", "/left/robot"),
        ("_NODE_NAMESPACE_UNKNOWN_", "_NODE_NAME_UNKNOWN_", UNKNOWN),
        ("/", "a\n[FATAL] forged", INVALID),
        ("/", "", INVALID),
        ("/" + 300 * "x", "robot", INVALID),
    ],
)
def test_node_is_named_only_by_a_name_that_a_node_can_have(namespace, name, shown) -> None:
    info = TopicEndpointInfo(node_namespace=namespace, node_name=name)
    assert full_name(info) == shown


def test_message_about_many_nodes_names_a_few() -> None:
    (fault,) = several_publishers("/pose", [f"/n{number:03}" for number in range(500)], "effect")
    assert "given 500 (/n000, /n001, " in fault.message and ", /n007, ...)" in fault.message
