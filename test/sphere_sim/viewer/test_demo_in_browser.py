# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Demo at a terminal: a page that shows the run, and then sends goals."""

import os
import re
import select
import subprocess
import time

import psutil
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser import Browser, find_browser
from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import Graph

from sphere_nmpc.model.state import state_error
from sphere_nmpc.ros.messages import pose_from_ros
from sphere_sim.ros.session.child_process import verb_command
from sphere_sim.scenario.scenarios import PAPER_CASES

BROWSER = find_browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here: apt-get install chromium"),
]


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


def _pick_a_goal(page: Browser) -> None:
    """Select a goal from the list, and wait until the sphere is there."""
    graph = Graph()
    try:
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        goals = graph.collect(PoseStamped, "controller/active_goal", latched)
        poses = graph.collect(PoseStamped, "pose", 1)
        goal = PAPER_CASES[1].start

        def error() -> float:
            return state_error(pose_from_ros(poses[-1]), goal)

        graph.until(lambda: goals and poses)
        assert error() > 1.0
        page.choose("pick a goal …", "start of the paper's case 1")
        graph.until(lambda: state_error(pose_from_ros(goals[-1]), goal) < 1e-9)
        graph.until(lambda: error() < 0.05)
    finally:
        graph.close()


def test_demo_shows_the_run_and_then_accepts_goals_from_the_page(
    tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = ["--case", "3", "--no-compare", "--out", str(tmp_path / "out")]
    terminal = Terminal(*verb_command("demo", *own))
    home = tmp_path / "browser"
    home.mkdir()
    try:
        domain = terminal.wait_for(r"ROS domain (\d+)").group(1)
        monkeypatch.setenv("ROS_DOMAIN_ID", domain)
        page_named = r"http://127\.0\.0\.1:\d+/\?token=[\w-]+(?=[\s\x1b])"
        address = terminal.wait_for(page_named).group()
        children = psutil.Process(terminal.process.pid).children(recursive=True)
        assert len(children) == 5, "four nodes, and the controller's worker"
        terminal.wait_for("the nodes run on")
        assert (tmp_path / "out" / "summary.json").exists()
        with Browser(BROWSER, home) as page:
            page.open(address)
            page.wait_for("live")
            assert re.search(r"to the goal: 0\.0", page.text)
            _pick_a_goal(page)
            assert page.console == []
        terminal.enter()
        assert terminal.process.wait(PATIENCE) == 0, terminal.output
    finally:
        terminal.close()
    assert not [child for child in children if child.is_running()]
