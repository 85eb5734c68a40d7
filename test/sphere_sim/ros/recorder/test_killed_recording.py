# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Report and replay of a run of real nodes whose recorder was killed."""

import json
import re
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from mcap.reader import make_reader
from patience import PATIENCE
from ruamel.yaml import YAML
from verb_process import start

from sphere_sim.cli.main import main as command
from sphere_sim.recording.run_reader import read_run


@pytest.fixture
def killed_bag(graph, tmp_path) -> Path:
    """Return a bag of at least 3 s with a goal, whose recorder was killed."""
    bag, clock = tmp_path / "bag", ("-p", "use_sim_time:=true")
    nodes = [
        start(tmp_path, "recorder", "--ros-args", *clock, "-p", f"output:={bag}"),
        start(tmp_path, "controller", "--ros-args", *clock),
        start(tmp_path, "simulator", "--ros-args"),
    ]
    try:
        poses = graph.collect(PoseStamped, "pose", 100)
        goals = graph.publisher(PoseStamped, "goal_pose")
        graph.until(lambda: (bag / "metadata.yaml").exists() and poses)
        goal = PoseStamped()
        goal.header.frame_id, goal.pose.position.x, goal.pose.orientation.w = "world", 0.5, 1.0
        goals.publish(goal)
        graph.until(lambda: 1e-9 * committed(bag)["duration"]["nanoseconds"] > 3.0)
        nodes[0].send_signal(signal.SIGKILL)
        nodes[0].wait(PATIENCE)
    finally:
        for node in nodes:
            node.kill()
            node.wait(PATIENCE)
    return bag


def committed(bag: Path) -> dict[str, Any]:
    """Return the metadata of what is on disk."""
    text = (bag / "metadata.yaml").read_text()
    return YAML(typ="safe").load(text)["rosbag2_bagfile_information"]


@pytest.mark.slow
def test_killed_recording_can_be_reported_and_replayed(killed_bag, tmp_path, capsys) -> None:
    with next(killed_bag.glob("*.mcap")).open("rb") as stream:
        found = sum(1 for _ in make_reader(stream).iter_messages())
    assert found >= committed(killed_bag)["message_count"] > 0
    recorded = read_run(killed_bag)
    assert recorded.times[-1] > 2.0, "the poses begin after the clock"
    assert recorded.goals.size and recorded.plans and recorded.solves.times.size
    assert command(["report", str(killed_bag), "--out", str(tmp_path / "out"), "--csv"]) == 0
    printed = capsys.readouterr()
    assert "is truncated" not in printed.err and "damaged" not in printed.err
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    (figures,) = summary.values()
    assert figures["metrics"]["final_error"] is not None
    viewer = start(tmp_path, "viewer", "--port", "0", "--replay", str(killed_bag))
    try:
        log, end = tmp_path / "viewer.log", time.monotonic() + PATIENCE
        while not re.search(r"http://", log.read_text(encoding="utf-8")):
            assert viewer.poll() is None and time.monotonic() < end, log.read_text()
            time.sleep(0.1)
    finally:
        viewer.send_signal(signal.SIGINT)
        viewer.wait(PATIENCE)
