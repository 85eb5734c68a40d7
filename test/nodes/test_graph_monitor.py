# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the graph around a node: when they are found, and their lines in the log."""

import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from patience import PATIENCE
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.reporting.fault_log import FaultLog
from sphere_nmpc.ros import graph_monitor
from sphere_nmpc.ros.graph_monitor import (
    INVALID,
    UNKNOWN,
    GraphMonitor,
    full_name,
)
from sphere_nmpc.ros.input_monitor import SILENCE_LIMIT, GraphState, find_faults

LONG = 10.0 * SILENCE_LIMIT
NAMELESS = Condition(Kind.OTHER_PUBLISHER, f"given 2 (/simulator, {UNKNOWN})", "/pose")
NAMED = Condition(Kind.OTHER_PUBLISHER, "given 2 (/simulator, /simulator)", "/pose")


@pytest.mark.parametrize(
    ("pose_silence", "pose_age", "kinds"),
    [(0.1, 0.0, []), (0.1, -5.0, [Kind.CLOCK_ENDED]), (LONG, 0.0, [Kind.CLOCK_ENDED])],
    ids=["paused", "no clock messages", "ended"],
)
def test_stopped_clock_is_a_fault_unless_the_simulator_repeats_its_last_pose(
    pose_silence, pose_age, kinds
) -> None:
    state = GraphState(
        follows_clock=True, time=3.0, clock_silence=LONG, silence=pose_silence,
        age=pose_age, timeout=0.5, clocks=["/simulator"], senders=["/simulator"],
    )
    assert [fault.kind for fault in find_faults(state)] == kinds


@pytest.mark.parametrize(
    ("follows_clock", "age", "has_stamp", "clocks", "advice"),
    [
        (False, 1.8e9, False, [], "set header.stamp"),
        (False, 1.8e9, False, ["/simulator"], "set header.stamp"),
        (True, 1.8e9, False, ["/clock_of_the_system"], "set header.stamp"),
        (True, 5.0, False, ["/simulator"], "set header.stamp"),
        (False, 1.8e9, True, [], "set header.stamp"),
        (False, 1.8e9, True, ["/simulator"], "use_sim_time:=true"),
        (True, -1.8e9, True, ["/simulator"], "use_sim_time:=false"),
    ],
)
def test_advice_on_stamps_of_another_clock_leads_in_no_circle(
    follows_clock, age, has_stamp, clocks, advice
) -> None:
    (fault,) = find_faults(GraphState(
        follows_clock, 1.0, 0.0, 0.0, age, 0.5, clocks, ["/bridge"], has_stamp=has_stamp
    ))
    assert advice in fault.text


@pytest.mark.parametrize(
    ("namespace", "name", "shown"),
    [
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


@pytest.mark.parametrize(
    ("limit", "seen", "logged"),
    [
        (PATIENCE, [NAMELESS, NAMELESS, NAMED, NAMED], [NAMED]),
        (PATIENCE, [NAMED, NAMELESS, NAMED], [NAMED]),
        (-1.0, [NAMELESS, NAMELESS], [NAMELESS]),
    ],
    ids=["named soon", "named at once", "never named"],
)
def test_fault_is_logged_once_when_the_name_of_the_node_is_known(
    graph, monkeypatch, limit, seen, logged
) -> None:
    monkeypatch.setattr(graph_monitor, "NAMED_WITHIN", limit)
    lines: list[str] = []
    monitor = GraphMonitor(graph.probe, FaultLog(lines.append))
    for fault in seen:
        monitor.update([fault])
        assert monitor.faults[0] == fault, "the status has it at once"
    assert lines == [str(fault) for fault in logged]


def test_publisher_of_another_type_is_none_of_the_topic_and_named_where_it_is_alone(graph) -> None:
    monitor, probe = GraphMonitor(graph.probe, FaultLog(print)), graph.probe
    graph.publisher_apart(PoseWithCovarianceStamped, "pose")
    graph.publisher_apart(Float64, "/clock")
    probe.create_subscription(PoseStamped, "pose", print, 10)
    probe.create_publisher(Clock, "/clock", 10)
    graph.until(lambda: [probe.count_publishers(it) for it in ("/pose", "/clock")] == [1, 2])
    graph.until(lambda: UNKNOWN not in monitor.incompatible()[0].text)
    (alone,) = monitor.incompatible()
    assert str(alone) == (
        "other type on /pose: given a publisher of /pose of type "
        "geometry_msgs/msg/PoseWithCovarianceStamped (/localiser), expected "
        "geometry_msgs/msg/PoseStamped; its messages are not received: remap one side, "
        "-r /pose:=/its/topic"
    )
    probe.create_publisher(PoseStamped, "pose", 10)
    graph.until(lambda: probe.count_publishers("/pose") == 2)
    assert not monitor.incompatible() and not monitor.further_publishers(clocked=True)
