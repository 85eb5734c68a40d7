# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The recorder over real DDS: what it hears, when it may start, and how it ends."""

import json
import signal
import subprocess
import time
from collections import Counter
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2 import Reader
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from sphere_nmpc.ros.conversions import stamp_to_ros
from sphere_sim.ros.session.child_process import verb_command

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


class Recording:
    """The node as a process of its own."""

    def __init__(self, folder: Path, graph, *arguments: str) -> None:
        self.folder = folder
        self._graph = graph
        self.process = subprocess.Popen(
            verb_command("recorder", "--ros-args", "-p", f"output:={folder}", *arguments),
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )

    def heard(self) -> set[str]:
        answer = self._graph.call(Trigger, "recorder/is_recording", Trigger.Request())
        lines = answer.message.splitlines()
        return {line.partition(" ")[2] for line in lines if line.startswith("heard")}

    def wait_to_hear(self, *topics: str) -> None:
        end = time.monotonic() + 20.0
        while not set(topics) <= self.heard():
            assert time.monotonic() < end, f"heard {self.heard()}, expected {topics}"

    def end(self, number: int = signal.SIGINT) -> str:
        self.process.send_signal(number)
        told, _ = self.process.communicate(timeout=20.0)
        return told


@pytest.fixture
def record(tmp_path, graph):
    recordings = []

    def start(*arguments: str) -> Recording:
        recordings.append(Recording(tmp_path / "bag", graph, *arguments))
        return recordings[-1]

    yield start
    for recording in recordings:
        recording.process.kill()
        recording.process.communicate()


def counted(folder: Path) -> Counter[str]:
    """Return the messages by topic; both readers must agree."""
    with Reader(folder) as reader:
        of_rosbags = Counter(connection.topic for connection, *_ in reader.messages())
    with next(folder.glob("*.mcap")).open("rb") as stream:
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()])
        of_mcap = Counter(c.topic for _, c, *_ in decoded.iter_decoded_messages())
    assert of_rosbags == of_mcap
    return of_rosbags


@pytest.mark.slow
def test_records_what_every_kind_of_publisher_says(graph, record) -> None:
    probe = graph.probe
    latched = probe.create_publisher(PoseStamped, "controller/active_goal", LATCHED)
    latched.publish(PoseStamped())  # before the recorder is there
    early = probe.create_publisher(PoseStamped, "pose", 10)
    recording = record()
    recording.wait_to_hear("/controller/active_goal")
    # Publishers that join late, unknown beforehand or less reliable than expected:
    late = probe.create_publisher(Odometry, "odom", BEST_EFFORT)
    unknown = probe.create_publisher(String, "controller/anything", 10)
    foreign = probe.create_publisher(String, "somebody_elses", 10)
    graph.until(lambda: all(p.get_subscription_count() for p in (early, late, unknown)))
    while not {"/pose", "/odom", "/controller/anything"} <= recording.heard():
        for publisher, message in (
            (early, PoseStamped()), (late, Odometry()), (unknown, String()), (foreign, String())
        ):
            publisher.publish(message)
    metadata = recording.folder / "metadata.yaml"
    graph.until(lambda: "parameters:/probe" in metadata.read_text())
    told = recording.end()
    assert recording.process.returncode == 0 and "messages on" in told
    counts = counted(recording.folder)
    assert counts["/controller/active_goal"] == 1
    assert min(counts[t] for t in ("/pose", "/odom", "/controller/anything")) > 0
    assert "/somebody_elses" not in counts
    with Reader(recording.folder) as reader:
        qos = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
        custom = reader.storage.metadata.custom
    assert qos["/odom"][0].reliability.name == "BEST_EFFORT"
    assert qos["/controller/active_goal"][0].durability.name == "TRANSIENT_LOCAL"
    assert "use_sim_time" in json.loads(custom["parameters:/probe"])


@pytest.mark.slow
def test_killed_recorder_loses_at_most_a_second(graph, record) -> None:
    recording = record()
    speaker = graph.publisher(Float64MultiArray, "rotor_commands")
    recording.wait_to_hear()
    sent = []
    end = time.monotonic() + 2.5
    while time.monotonic() < end:
        speaker.publish(Float64MultiArray(data=[float(len(sent)), 0.0]))
        sent.append(time.monotonic())
        time.sleep(0.005)
    killed = time.monotonic()
    recording.end(signal.SIGKILL)
    count = counted(recording.folder)["/rotor_commands"]
    assert count >= sum(when < killed - 1.0 for when in sent)


@pytest.mark.slow
def test_simulated_time_stamps_messages_and_what_came_before_it_is_kept(graph, record) -> None:
    # The clock is recorded in any case.
    recording = record("-p", "use_sim_time:=true", "-p", "topics:=[goal_pose]")
    goal = graph.publisher(PoseStamped, "goal_pose")
    clock = graph.publisher(Clock, "/clock")
    goal.publish(PoseStamped())
    recording.wait_to_hear("/goal_pose")
    for stamp in (0, 40_000_000, 50_000_000):
        clock.publish(Clock(clock=stamp_to_ros(stamp)))
    recording.wait_to_hear("/clock", "/goal_pose")
    recording.end()
    with Reader(recording.folder) as reader:
        stamps = {}
        for connection, stamp, _ in reader.messages():
            stamps.setdefault(connection.topic, []).append(stamp)
    assert stamps["/goal_pose"] == [40_000_000]
    assert stamps["/clock"] == [40_000_000, 40_000_000, 50_000_000]


@pytest.mark.slow
def test_start_and_stop_make_separate_bags(graph, record) -> None:
    recording = record("-p", "record_on_start:=false", "-r", "__ns:=/left")
    call = lambda verb: graph.call(Trigger, f"/left/recorder/{verb}", Trigger.Request())  # noqa: E731
    assert not call("is_recording").success and not call("stop").success
    assert call("start").success
    again = call("start")
    assert not again.success and "already recording" in again.message
    assert call("is_recording").success
    assert call("stop").success
    second = call("start")
    assert second.success and second.message.endswith("bag_1")
    speaker = graph.publisher(DiagnosticArray, "/diagnostics")
    speaker.publish(DiagnosticArray())
    time.sleep(0.5)
    recording.end()
    assert "/diagnostics" not in counted(recording.folder)
    assert counted(recording.folder.with_name("bag_1"))["/diagnostics"] == 1


def test_existing_folder_is_told_in_one_line(tmp_path, record) -> None:
    (tmp_path / "bag").mkdir()
    recording = record()
    told, _ = recording.process.communicate(timeout=30.0)
    assert recording.process.returncode == 1
    assert "exists already" in told and "Traceback" not in told


def test_recorder_that_hears_nothing_leaves_an_empty_bag(record) -> None:
    recording = record("-p", "topics:=[pose]")
    recording.wait_to_hear()
    assert "Traceback" not in recording.end()
    assert counted(recording.folder) == {}
