# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Report of a run of real nodes whose recorder was killed."""

import signal
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from mcap.reader import make_reader
from patience import PATIENCE
from ruamel.yaml import YAML
from trajectory_msgs.msg import JointTrajectory
from verb_process import start

from sphere_sim.cli.main import main as command
from sphere_sim.recording.run_reader import read_run
from sphere_sim.report import report_files

TOPICS = {"/controller/active_goal", "/controller/status", "/rotor_trajectory"}


def committed(bag: Path) -> dict[str, Any]:
    """Return the metadata of what is on disk."""
    text = (bag / "metadata.yaml").read_text()
    return YAML(typ="safe").load(text)["rosbag2_bagfile_information"]


@pytest.mark.slow
def test_killed_recording_of_a_run_can_be_reported(graph, tmp_path, capsys, monkeypatch) -> None:
    bag, clock = tmp_path / "bag", ("-p", "use_sim_time:=true")
    nodes = [
        start(tmp_path, "recorder", "--ros-args", *clock, "-p", f"output:={bag}"),
        start(tmp_path, "controller", "--ros-args", *clock),
        start(tmp_path, "simulator", "--ros-args"),
    ]
    try:
        poses = graph.collect(PoseStamped, "pose", 100)
        plans = graph.collect(JointTrajectory, "rotor_trajectory", 100)

        def on_disk() -> float:
            return 1e-9 * float(committed(bag)["duration"]["nanoseconds"])

        goals = graph.publisher(PoseStamped, "goal_pose")
        graph.until(lambda: (bag / "metadata.yaml").exists() and poses)
        goal = PoseStamped()
        goal.header.frame_id, goal.pose.position.x, goal.pose.orientation.w = "world", 0.5, 1.0
        goals.publish(goal)
        graph.until(lambda: plans)

        def is_recorded() -> bool:
            """Another goal until the recorder has found all topics, after any arrival."""
            if {
                one["topic_metadata"]["name"]
                for one in committed(bag)["topics_with_message_count"] if one["message_count"]
            } >= TOPICS:
                return True
            goal.pose.position.x = 1.5 - goal.pose.position.x
            goals.publish(goal)
            graph.spin_for(2.0)
            return False

        graph.until(is_recorded)
        planned = on_disk()
        graph.until(lambda: on_disk() > planned + 2.0)
        nodes[0].send(signal.SIGKILL)
        nodes[0].wait(PATIENCE)
    finally:
        for node in nodes:
            node.kill()
    with next(bag.glob("*.mcap")).open("rb") as stream:
        found = sum(1 for _ in make_reader(stream).iter_messages())
    assert found >= committed(bag)["message_count"] > 0
    recorded = read_run(bag)
    assert recorded.times[-1] > 2.0, "the poses begin after the clock"
    assert recorded.goals and recorded.plans and recorded.solves.times.size
    monkeypatch.setattr(report_files, "FIGURES", {})
    assert command(["report", str(bag), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr()
    assert "is truncated" not in printed.err and "damaged" not in printed.err
    assert "final_error" in (tmp_path / "out" / "summary.json").read_text(encoding="utf-8")
