# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Recorder node over DDS: subscriptions, services and end."""

import json
import signal
import sys
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from nav_msgs.msg import Odometry
from patience import PATIENCE
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from std_msgs.msg import String
from std_srvs.srv import Trigger
from verb_process import start

from sphere_nmpc.process.child import Child
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_sim.ros.recorder.frames import TRANSFORMS
from sphere_sim.ros.recorder.node import RecorderNode, _message_class
from sphere_sim.ros.simulator.node import SimulatorNode

BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def record(tmp_path):
    processes = []

    def begin(*arguments: str) -> Child:
        given = "--ros-args", "-p", f"output:={tmp_path / 'bag'}", *arguments
        processes.append(start(tmp_path, "recorder", *given))
        return processes[-1]

    yield begin
    for process in processes:
        process.kill()


def received(graph, namespace: str = "") -> set[str]:
    """Return the topics of which the node has received a message."""
    answer = graph.call(Trigger, f"{namespace}/recorder/is_recording")
    lines = answer.message.splitlines()
    return {line.partition(" ")[2] for line in lines if line.startswith("received")}


def counted(folder: Path) -> Counter[str]:
    """Return the number of messages by topic, on which both readers must agree."""
    with Reader(folder) as reader:
        of_rosbags = Counter(connection.topic for connection, *_ in reader.messages())
    with next(folder.glob("*.mcap")).open("rb") as stream:
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()])
        of_mcap = Counter(c.topic for _, c, *_ in decoded.iter_decoded_messages())
    assert of_rosbags == of_mcap
    return of_rosbags


@pytest.mark.slow
def test_messages_of_every_kind_of_publisher_are_recorded(graph, record, tmp_path) -> None:
    probe = graph.probe
    probe.declare_parameter("bytes", [b"\x01", b"\xff"])
    latched = probe.create_publisher(PoseStamped, "controller/active_goal", LATCHED)
    latched.publish(PoseStamped())  # before the recorder starts
    early = probe.create_publisher(PoseStamped, "pose", 10)
    recording = record()
    graph.until(lambda: "/controller/active_goal" in received(graph))
    # Publishers that are late, unknown beforehand or less reliable than expected:
    late = probe.create_publisher(Odometry, "odom", BEST_EFFORT)
    unknown = probe.create_publisher(String, "controller/anything", 10)
    foreign = probe.create_publisher(String, "another_topic", 10)
    graph.until(lambda: all(p.get_subscription_count() for p in (early, late, unknown)))
    while not {"/pose", "/odom", "/controller/anything"} <= received(graph):
        for publisher, message in (
            (early, PoseStamped()), (late, Odometry()), (unknown, String()), (foreign, String())
        ):
            publisher.publish(message)
    metadata = tmp_path / "bag" / "metadata.yaml"
    graph.until(lambda: "parameters:/probe" in metadata.read_text())
    recording.send(signal.SIGHUP)  # as when its terminal is closed
    assert recording.wait(PATIENCE) == 0
    assert "messages on" in (tmp_path / "recorder.log").read_text()
    counts = counted(tmp_path / "bag")
    assert counts["/controller/active_goal"] == 1
    assert min(counts[t] for t in ("/pose", "/odom", "/controller/anything")) > 0
    assert "/another_topic" not in counts
    with Reader(tmp_path / "bag") as reader:
        qos = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
        custom = reader.storage.metadata.custom
        assert reader.ros_distro == "jazzy" and reader.duration > 0
        assert reader.connections[0].digest.startswith("RIHS01_")
    assert qos["/odom"][0].reliability.name == "BEST_EFFORT"
    assert qos["/controller/active_goal"][0].durability.name == "TRANSIENT_LOCAL"
    parameters = json.loads(custom["parameters:/probe"])
    assert parameters["use_sim_time"] is False and parameters["bytes"] == [1, 255]


@pytest.mark.slow
def test_start_and_stop_make_separate_bags(graph, record, tmp_path) -> None:
    recording = record("-p", "record_on_start:=false", "-p", "topics:=[/diagnostics]",
                       "-r", "__ns:=/left")

    def call(verb: str) -> Trigger.Response:
        return graph.call(Trigger, f"/left/recorder/{verb}")

    assert not call("is_recording").success and not call("stop").success
    assert call("start").success
    again = call("start")
    assert not again.success and "already recording" in again.message
    assert call("is_recording").success
    assert call("stop").success
    second = call("start")
    assert second.success and second.message.endswith("bag_1")
    graph.send("/diagnostics", DiagnosticArray())
    graph.until(lambda: received(graph, "/left"))
    recording.send(signal.SIGINT)
    recording.wait(PATIENCE)
    assert "Traceback" not in (tmp_path / "recorder.log").read_text()
    assert counted(tmp_path / "bag") == {}
    assert counted(tmp_path / "bag_1") == {"/diagnostics": 1}


def test_type_of_a_recorded_topic_is_the_known_or_the_first_one(graph, tmp_path) -> None:
    bag = tmp_path / "bag"
    topics = ["pose", "aside/*"]
    other = graph.publisher_apart(PoseWithCovarianceStamped, "pose", LATCHED)
    first = graph.probe.create_publisher(String, "aside/any", 10)
    node = graph.start(RecorderNode, output=str(bag), topics=topics)
    graph.until(lambda: first.get_subscription_count() and node.count_publishers("/pose") == 1)
    second = graph.publisher_apart(PoseStamped, "aside/any")
    known = graph.probe.create_publisher(PoseStamped, "pose", 10)
    graph.until(lambda: len(node._monitor.faults) == 2)

    def all_recorded() -> bool:
        for sender in (other, first, second, known):
            sender.publish(sender.msg_type())
        node._record_arrived()
        return {"/pose", "/aside/any"} <= node._session.received

    graph.until(all_recorded)
    # The publisher of the first type ends, that of another one stays.
    graph.probe.destroy_publisher(first)
    graph.until(lambda: node.count_publishers("/aside/any") == 1)
    graph.spin_for(0.5)
    second.publish(PoseStamped())
    node.finish()
    assert set(counted(bag)) == {"/pose", "/aside/any"}
    with Reader(bag) as reader:
        types = {it.topic: it.msgtype for it in reader.connections}
    assert types == {
        "/pose": "geometry_msgs/msg/PoseStamped", "/aside/any": "std_msgs/msg/String",
    }
    assert sorted(fault.name for fault in node._monitor.faults) == [
        "other type on /aside/any", "other type on /pose",
    ]


@pytest.mark.skipif(find_spec("tf2_msgs") is not None, reason="other nodes publish /tf then")
def test_each_bag_has_the_model_and_the_transforms_however_late_it_begins(graph, tmp_path) -> None:
    graph.start(SimulatorNode, **{"robot.shell_radius": 0.25, "imu.position": [0.1, 0.0, 0.0]})
    node = graph.start(RecorderNode, output=str(tmp_path / "bag"), use_sim_time=True)
    for bag in (tmp_path / "bag", tmp_path / "bag_1"):
        graph.until(lambda: node._session._bag.message_count > 50)
        node._stop()
        assert counted(bag)["/robot_description"] == counted(bag)["/tf_static"] == 1
        frames = {}
        with AnyReader([bag]) as reader:
            kept = {it.topic for it in reader.connections for qos in it.ext.offered_qos_profiles
                    if qos.durability.name == "TRANSIENT_LOCAL"}
            for connection, _, data in reader.messages():
                if connection.msgtype == TRANSFORMS:
                    message = reader.deserialize(data, connection.msgtype)
                    frames |= {it.child_frame_id: it for it in message.transforms}
        assert kept >= {"/robot_description", "/tf_static"}
        assert frames["base_link"].transform.translation.z == 0.25
        assert frames["base_link"].header.frame_id == "world"
        assert frames["imu"].transform.translation.x == 0.1
        assert frames["rotor_1"].header.frame_id == "base_link" and "shell" in frames
        node._start()


@pytest.mark.parametrize(
    ("graph", "says"),
    [(None, KeyValue(key="pose_topic", value="/vrpn_mocap/ball/pose")),
     (["--ros-args", "-r", "pose:=/vrpn_mocap/ball/pose"], KeyValue())],
    indirect=["graph"], ids=["of the controller", "of the recorder"],
)
def test_remapped_poses_are_recorded_and_named(graph, tmp_path, says) -> None:
    bag = tmp_path / "bag"
    node = graph.start(RecorderNode, output=str(bag))
    status = graph.publisher(DiagnosticStatus, "controller/status")
    poses = graph.probe.create_publisher(PoseStamped, "/vrpn_mocap/ball/pose", 10)

    def all_recorded() -> bool:
        status.publish(DiagnosticStatus(values=[says]))
        poses.publish(PoseStamped())
        node._record_arrived()
        return "/vrpn_mocap/ball/pose" in node._session.received

    graph.until(all_recorded)
    graph.spin_for(0.3)
    node.finish()
    with Reader(bag) as reader:
        named = json.loads(reader.storage.metadata.custom["topics:/"])
    assert named["pose"] == "/vrpn_mocap/ball/pose" and named["joint_states"] == "/joint_states"


def test_announced_type_that_is_none_is_not_loaded() -> None:
    for msgtype in ("this/msg/Zen", "this.msg/msg/Zen", "a b/msg/Odd", "../msg/Odd", "String", "",
                    "std_msgs/String", "std_msgs/msg/", "std_msgs/msg/rosidl_parser"):
        assert _message_class(msgtype) is None
    assert "this" not in sys.modules
    assert _message_class("std_msgs/msg/String") is String
