# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The viewer in a real browser, beside real nodes over DDS; the tests build on each other."""

import re
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

pytest.importorskip("mujoco")

from browser import Browser, find_browser
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import Graph
from stage import insist, page_of, pixel, scene_of, start, stop, wait_for_scene

from sphere_nmpc.model.state import state_error
from sphere_nmpc.ros.conversions import pose_from_ros, stamp_from_ros
from sphere_sim.scenario.scenarios import PAPER_CASES

BROWSER = find_browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here: apt-get install chromium"),
]
SIMULATOR = (
    "-p", "initial_state:=[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]", "-p", "real_time_factor:=2.0",
    "-p", "plant:=rigid_body",  # it can be pushed
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
    statuses: list
    folder: Path

    @property
    def time(self) -> int:
        """Stamp of the newest pose [ns]."""
        return stamp_from_ros(self.poses[-1].header.stamp)

    @property
    def status(self) -> dict[str, str]:
        """What the controller said last."""
        return {pair.key: pair.value for pair in self.statuses[-1].values}

    def restart(self, verb: str, *arguments: str) -> None:
        self.processes[verb] = start(self.folder, verb, "--ros-args", *arguments)


@pytest.fixture(scope="module")
def stage(tmp_path_factory) -> Iterator[Stage]:
    folder = tmp_path_factory.mktemp("stage")
    processes = {
        "simulator": start(folder, "simulator", "--ros-args", *SIMULATOR),
        "controller": start(folder, "controller", "--ros-args", *CONTROLLER),
        "viewer": start(folder, "viewer", "--port", "0"),
    }
    graph = Graph()
    poses = graph.hear(PoseStamped, "pose", 1)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    goals = graph.hear(PoseStamped, "controller/active_goal", latched)
    statuses = graph.hear(DiagnosticStatus, "controller/status", 1)
    home = folder / "browser"
    home.mkdir()
    try:
        graph.until(lambda: page_of(folder))
        with Browser(BROWSER, home) as page:
            page.open(page_of(folder))
            yield Stage(page, graph, processes, poses, goals, statuses, folder)
    finally:
        graph.close()
        stop(processes.values())
        for log in sorted(folder.glob("*.log")):  # shown where a test failed
            print(f"{log.name}:\n{log.read_text(errors='replace')[-3000:]}")


def test_page_comes_up_live_and_without_errors(stage, tmp_path) -> None:
    stage.page.wait_for("live")
    assert stage.page.console == []
    own = re.compile(r"http://127\.0\.0\.1|data:|blob:")
    assert [url for url in stage.page.requested if not own.match(url)] == []
    stage.page.settle()
    wait_for_scene(stage.page, tmp_path / "start.png")


def test_dragging_the_goal_makes_the_sphere_roll_there(stage, tmp_path) -> None:
    before = scene_of(stage.page, tmp_path / "before.png")
    # The arrow along x, by its shaft, one metre on.
    stage.page.drag(pixel(stage.page, (0.5, 0.0, RADIUS)), pixel(stage.page, (1.5, 0.0, RADIUS)))
    stage.graph.until(lambda: stage.goals)
    goal = pose_from_ros(stage.goals[-1])
    assert goal[0] == pytest.approx(1.0, abs=0.3) and abs(goal[1]) < 1e-3
    assert abs(goal[2]) == pytest.approx(1.0, abs=1e-3)
    stage.graph.until(lambda: state_error(pose_from_ros(stage.poses[-1]), goal) < 0.05)
    time.sleep(1.0)
    after = scene_of(stage.page, tmp_path / "after.png")
    assert np.mean(np.abs(after - before)) > 1.0


def test_pause_stops_time_and_resume_lets_it_go_on(stage) -> None:
    insist(
        stage.graph.until, lambda: stage.page.click_button("Pause"),
        lambda: "time stands still" in stage.page.text,
    )
    stage.graph.spin_for(0.5)
    stood = stage.time
    stage.graph.spin_for(1.0)
    assert stage.time == stood
    insist(
        stage.graph.until, lambda: stage.page.click_button("Resume"), lambda: stage.time > stood
    )
    stage.page.wait_for("live")


def test_a_push_moves_the_sphere_and_the_controller_brings_it_back(stage) -> None:
    goal = pose_from_ros(stage.goals[-1])
    stage.graph.spin_for(0.2)
    insist(
        stage.graph.until, lambda: stage.page.click_button("Push"),
        lambda: state_error(pose_from_ros(stage.poses[-1]), goal) > 0.1,
    )
    stage.graph.until(lambda: state_error(pose_from_ros(stage.poses[-1]), goal) < 0.05)


def test_speed_and_strategy_can_be_chosen(stage) -> None:
    def change(before: str, after: str) -> None:
        insist(
            stage.graph.until, lambda: stage.page.choose(before, after),
            lambda: bool(stage.statuses) and stage.status["strategy"] == after,
        )

    change("time_optimal", "paper")
    change("paper", "time_optimal")

    def pace() -> float:
        then, began = stage.time, time.monotonic()
        stage.graph.spin_for(1.0)
        return (stage.time - then) * 1e-9 / (time.monotonic() - began)

    insist(stage.graph.until, lambda: stage.page.type_number("speed", "0.1"), lambda: pace() < 0.3)
    insist(stage.graph.until, lambda: stage.page.type_number("speed", "2"), lambda: pace() > 0.5)


def test_a_goal_can_be_picked_from_the_list(stage) -> None:
    insist(
        stage.graph.until,
        lambda: stage.page.choose("pick a goal …", "goal of the paper's case 2"),
        lambda: state_error(pose_from_ros(stage.goals[-1]), PAPER_CASES[2].goal) < 1e-9,
    )


def test_a_page_and_a_viewer_that_join_late_show_what_holds(stage) -> None:
    stage.page.open("about:blank")
    stop([stage.processes["viewer"]])
    stage.processes["viewer"] = start(stage.folder, "viewer", "--port", "0")
    stage.graph.until(lambda: page_of(stage.folder))
    stage.page.open(page_of(stage.folder))
    stage.page.wait_for("to the goal")
    stage.page.wait_for("live")


@pytest.mark.parametrize(
    ("name", "arguments", "told"),
    [("controller", CONTROLLER, "controller silent for"), ("simulator", SIMULATOR, "no pose for")],
)
def test_a_node_that_is_killed_is_missed_and_welcome_again(stage, name, arguments, told) -> None:
    # How soon is a matter of `Health`, which is tested without a page.
    stage.processes[name].kill()
    stage.page.wait_for(told)
    stage.restart(name, *arguments)
    stage.page.wait_for("live")


def test_the_page_had_no_error_all_the_while(stage) -> None:
    assert stage.page.console == []
