# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is left of a run of real nodes whose recorder was killed: report and viewer take it."""

import json
import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped
from verb_process import start

from sphere_nmpc.ros.conversions import seconds, stamp_from_ros
from sphere_sim.cli.main import main as command
from sphere_sim.recording.run_reader import read_run

LOST = 1.5
"""What a recorder that is killed may lose [s]."""


@pytest.fixture
def run(graph, tmp_path) -> Iterator[tuple[Path, float]]:
    """Yield a bag whose recorder was killed, and the last time it could hear [s]."""
    bag, clock = tmp_path / "bag", ("-p", "use_sim_time:=true")
    nodes = [
        start(tmp_path, "recorder", "--ros-args", *clock, "-p", f"output:={bag}"),
        start(tmp_path, "controller", "--ros-args", *clock),
        start(tmp_path, "simulator", "--ros-args"),
    ]
    try:
        poses = graph.collect(PoseStamped, "pose", 100)
        goals = graph.publisher(PoseStamped, "goal_pose")
        graph.until(lambda: (bag / "metadata.yaml").exists() and poses, 60.0)
        goal = PoseStamped()
        goal.header.frame_id, goal.pose.position.x, goal.pose.orientation.w = "world", 0.5, 1.0
        goals.publish(goal)
        begun = _time(poses[-1])
        graph.until(lambda: _time(poses[-1]) > begun + 5.0, 60.0)
        nodes[0].send_signal(signal.SIGKILL)
        killed = _time(poses[-1])
        nodes[0].wait(10.0)
    finally:
        for node in nodes:
            node.kill()
            node.wait(10.0)
    yield bag, killed


def _time(pose: PoseStamped) -> float:
    return seconds(stamp_from_ros(pose.header.stamp))


@pytest.mark.slow
def test_a_killed_recording_is_reported_on_and_replayed(run, tmp_path, capsys) -> None:
    bag, killed = run
    recorded = read_run(bag)
    assert recorded.origin + recorded.times[-1] >= killed - LOST
    assert recorded.goals.size and recorded.plans and recorded.solves.times.size
    assert command(["report", str(bag), "--out", str(tmp_path / "out"), "--csv"]) == 0
    told = capsys.readouterr()
    assert "is truncated" not in told.err and "damaged" not in told.err
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    (figures,) = summary.values()
    assert figures["metrics"]["final_error"] is not None
    viewer = start(tmp_path, "viewer", "--port", "0", "--replay", str(bag))
    try:
        log, end = tmp_path / "viewer.log", time.monotonic() + 60.0
        while not re.search(r"http://", log.read_text(encoding="utf-8")):
            assert viewer.poll() is None and time.monotonic() < end, log.read_text()
            time.sleep(0.1)
    finally:
        viewer.send_signal(signal.SIGINT)
        viewer.wait(20.0)
