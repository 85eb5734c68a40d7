# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Demo at a terminal: a page that shows the run, and nodes that run on until Enter."""

import os
import re
import select
import subprocess
import time
import urllib.request

import psutil
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
from ros_graph import Graph

from sphere_nmpc.ros.messages import pose_to_ros
from sphere_sim.ros.session.child_process import verb_command
from sphere_sim.scenario.scenarios import PAPER_CASES

pytestmark = pytest.mark.slow


class Terminal:
    """Command in a pseudo-terminal."""

    def __init__(self, *command: str) -> None:
        self._own, other = os.openpty()
        environment = {**os.environ, "TERM": "dumb", "COLUMNS": "200"}
        self.process = subprocess.Popen(
            command, stdin=other, stdout=other, stderr=other, env=environment
        )
        os.close(other)
        self.output = ""

    def wait_for(self, pattern: str) -> re.Match:
        """Return the match of a pattern in the output, once there is one."""
        end = time.monotonic() + PATIENCE
        while not (found := re.search(pattern, self.output)):
            assert time.monotonic() < end and self.process.poll() is None, self.output
            if select.select([self._own], [], [], 0.1)[0]:
                self.output += os.read(self._own, 65536).decode(errors="replace")
        return found

    def enter(self) -> None:
        os.write(self._own, b"\n")

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(PATIENCE)
        os.close(self._own)


def test_demo_shows_the_run_and_then_accepts_goals(
    tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = ["--case", "3", "--no-compare", "--out", str(tmp_path / "out")]
    terminal = Terminal(*verb_command("demo", *own))
    try:
        domain = terminal.wait_for(r"ROS domain (\d+)").group(1)
        monkeypatch.setenv("ROS_DOMAIN_ID", domain)
        page_named = r"http://127\.0\.0\.1:\d+/\?token=[\w-]+(?=[\s\x1b])"
        address = terminal.wait_for(page_named).group()
        children = psutil.Process(terminal.process.pid).children(recursive=True)
        assert len(children) == 5, "four nodes, and the controller's worker"
        terminal.wait_for("the nodes run on")
        assert (tmp_path / "out" / "summary.json").exists()
        with urllib.request.urlopen(address, timeout=PATIENCE) as page:
            assert page.status == 200
        graph = Graph()
        try:
            poses, goals = (graph.collect(PoseStamped, "pose", 1),
                            graph.publisher(PoseStamped, "goal_pose"))
            goals.publish(pose_to_ros(PAPER_CASES[1].start, 0, 0.3, ""))
            graph.until(lambda: poses)
            before = poses[-1].pose.position
            graph.until(lambda: abs(poses[-1].pose.position.x - before.x) > 0.01)
        finally:
            graph.close()
        terminal.enter()
        assert terminal.process.wait(PATIENCE) == 0, terminal.output
    finally:
        terminal.close()
    assert not [child for child in children if child.is_running()]
