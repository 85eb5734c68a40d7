# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The viewer in a real browser, beside real nodes over DDS; the tests build on each other."""

import io
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser import Browser, find_browser
from geometry_msgs.msg import PoseStamped
from PIL import Image
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import Graph

from sphere_nmpc.model.state import state_error
from sphere_nmpc.ros.conversions import pose_from_ros, stamp_from_ros
from sphere_sim.viewer.scene import CAMERA, LOOK_AT
from sphere_sim.viewer.server import free_port

BROWSER = find_browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here: apt-get install chromium"),
]
SIMULATOR = (
    "-p", "initial_state:=[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]", "-p", "real_time_factor:=2.0",
)
CONTROLLER = ("-p", "use_sim_time:=true", "-p", "strategy:=time_optimal")
RADIUS = 0.3


@dataclass
class Stage:
    """The nodes, the page, and a probe in the graph."""

    page: Browser
    graph: Graph
    processes: dict[str, subprocess.Popen]
    poses: list
    goals: list


def start(folder: Path, verb: str, *arguments: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "sphere_sim.cli.child", str(os.getpid()), verb, *arguments]
    with (folder / f"{verb}.log").open("wb") as log:
        return subprocess.Popen(command, stdout=log, stderr=log)


@pytest.fixture(scope="module")
def stage(tmp_path_factory) -> Iterator[Stage]:
    folder = tmp_path_factory.mktemp("stage")
    port = free_port(0)
    processes = {
        "simulator": start(folder, "simulator", "--ros-args", *SIMULATOR),
        "controller": start(folder, "controller", "--ros-args", *CONTROLLER),
        "viewer": start(folder, "viewer", "--port", str(port)),
    }
    graph = Graph()
    poses = graph.hear(PoseStamped, "pose", 1)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    goals = graph.hear(PoseStamped, "controller/active_goal", latched)
    home = folder / "browser"
    home.mkdir()
    try:
        graph.until(lambda: "http" in (folder / "viewer.log").read_text(), 40.0)
        with Browser(BROWSER, home) as page:
            page.open(f"http://127.0.0.1:{port}")
            yield Stage(page, graph, processes, poses, goals)
    finally:
        graph.close()
        for process in processes.values():
            process.send_signal(signal.SIGINT)
        for process in processes.values():
            try:
                process.wait(8.0)
            except subprocess.TimeoutExpired:
                process.kill()


def canvas(page: Browser) -> tuple[float, float, float, float]:
    """Return left, top, width and height of the scene [px]."""
    script = (
        "(() => { const r = [...document.querySelectorAll('canvas')]"
        ".map(c => c.getBoundingClientRect()).sort((a, b) => b.width * b.height -"
        " a.width * a.height)[0]; return [r.x, r.y, r.width, r.height]; })()"
    )
    return tuple(page.evaluate(script))


def pixel(page: Browser, point: tuple[float, float, float]) -> tuple[float, float]:
    """Return where a point of the world [m] is seen from where the camera stands at first."""
    left, top, width, height = canvas(page)
    camera, forward = np.array(CAMERA), np.array(LOOK_AT) - np.array(CAMERA)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    ray = np.array(point) - camera
    scale = 0.5 * height / np.tan(np.radians(45.0) / 2.0) / float(ray @ forward)
    return (
        left + 0.5 * width + scale * float(ray @ right),
        top + 0.5 * height - scale * float(ray @ up),
    )


def allowed(page: Browser) -> float:
    """Return within how long a loss must be told [s]: what was drawn late by the page is its own.

    Without a graphics card drawing is work for the processors that the nodes share.
    """
    return 2.0 + page.lag()


def scene_of(page: Browser, path: Path) -> np.ndarray:
    left, top, width, height = map(int, canvas(page))
    picture = Image.open(io.BytesIO(page.screenshot(path))).convert("RGB")
    return np.asarray(picture.crop((left, top, left + width, top + height)), dtype=float)


def test_page_comes_up_live_and_without_errors(stage, tmp_path) -> None:
    stage.page.wait_for("live", 60.0)
    assert stage.page.console == []
    own = re.compile(r"http://127\.0\.0\.1|data:|blob:")
    assert [url for url in stage.page.requested if not own.match(url)] == []
    stage.page.settle()
    end = time.monotonic() + 30.0  # the scene fades in
    while np.std(scene_of(stage.page, tmp_path / "start.png")) < 5.0:
        assert time.monotonic() < end, "an empty scene"
        time.sleep(0.5)


def test_dragging_the_goal_makes_the_sphere_roll_there(stage, tmp_path) -> None:
    before = scene_of(stage.page, tmp_path / "before.png")
    # The arrow along x, by its shaft, one metre on.
    stage.page.drag(pixel(stage.page, (0.5, 0.0, RADIUS)), pixel(stage.page, (1.5, 0.0, RADIUS)))
    stage.graph.until(lambda: stage.goals, 10.0)
    goal = pose_from_ros(stage.goals[-1])
    assert goal[0] == pytest.approx(1.0, abs=0.3) and abs(goal[1]) < 1e-3
    assert abs(goal[2]) == pytest.approx(1.0, abs=1e-3)
    stage.graph.until(lambda: state_error(pose_from_ros(stage.poses[-1]), goal) < 0.05, 40.0)
    time.sleep(1.0)
    after = scene_of(stage.page, tmp_path / "after.png")
    assert np.mean(np.abs(after - before)) > 1.0


def test_pause_stops_time_and_resume_lets_it_go_on(stage) -> None:
    stage.page.click_button("Pause")
    stage.page.wait_for("time stands still", 10.0)
    stage.graph.spin_for(0.5)
    stood = stamp_from_ros(stage.poses[-1].header.stamp)
    stage.graph.spin_for(1.0)
    assert stamp_from_ros(stage.poses[-1].header.stamp) == stood
    stage.page.click_button("Resume")
    stage.graph.until(lambda: stamp_from_ros(stage.poses[-1].header.stamp) > stood, 10.0)
    stage.page.wait_for("live", 10.0)


def test_a_controller_that_is_killed_is_missed_within_two_seconds(stage) -> None:
    patience = allowed(stage.page)
    stage.processes["controller"].kill()
    told = stage.page.wait_for("controller silent for", 15.0)
    assert told < patience


def test_a_simulator_that_is_killed_is_missed_within_two_seconds(stage) -> None:
    patience = allowed(stage.page)
    stage.processes["simulator"].kill()
    told = stage.page.wait_for("no pose for", 15.0)
    assert told < patience


def test_the_page_had_no_error_all_the_while(stage) -> None:
    assert stage.page.console == []
