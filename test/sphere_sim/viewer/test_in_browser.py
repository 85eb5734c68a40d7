# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Viewer in a real browser, with real nodes over DDS; the tests depend on their order."""

import re
import subprocess
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
from page_helpers import page_of, pixel, scene_of, wait_for_scene
from rcl_interfaces.srv import GetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import Graph
from verb_process import start, stop

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
    "-p", "plant:=rigid_body",  # accepts pushes
)
CONTROLLER = (
    "-p", "use_sim_time:=true", "-p", "strategy:=time_optimal",
    "-p", "goal_memory:=0.0",  # no goal of a controller of another test
)
RADIUS = 0.3


@dataclass
class Session:
    """Nodes, page, and a probe in the graph."""

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
        """Values of the newest status of the controller."""
        return {pair.key: pair.value for pair in self.statuses[-1].values}

    def real_time_factor(self) -> float:
        """Return the parameter of the simulator."""
        request = GetParameters.Request(names=["real_time_factor"])
        answer = self.graph.call(GetParameters, "simulator/get_parameters", request)
        return float(answer.values[0].double_value)

    def restart(self, verb: str, *arguments: str) -> None:
        self.processes[verb] = start(self.folder, verb, "--ros-args", *arguments)


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Iterator[Session]:
    folder = tmp_path_factory.mktemp("session")
    processes = {
        "simulator": start(folder, "simulator", "--ros-args", *SIMULATOR),
        "controller": start(folder, "controller", "--ros-args", *CONTROLLER),
        "viewer": start(folder, "viewer", "--port", "0"),
    }
    graph = Graph()
    poses = graph.collect(PoseStamped, "pose", 1)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    goals = graph.collect(PoseStamped, "controller/active_goal", latched)
    statuses = graph.collect(DiagnosticStatus, "controller/status", 1)
    home = folder / "browser"
    home.mkdir()
    try:
        graph.until(lambda: page_of(folder))
        with Browser(BROWSER, home) as page:
            page.open(page_of(folder))
            yield Session(page, graph, processes, poses, goals, statuses, folder)
    finally:
        graph.close()
        stop(processes.values())
        for log in sorted(folder.glob("*.log")):  # shown where a test failed
            print(f"{log.name}:\n{log.read_text(errors='replace')[-3000:]}")


def test_page_loads_without_errors_or_other_hosts(session, tmp_path) -> None:
    session.page.wait_for("live")
    assert session.page.console == []
    own = re.compile(r"http://127\.0\.0\.1|data:|blob:")
    assert [url for url in session.page.requested if not own.match(url)] == []
    session.page.settle()
    wait_for_scene(session.page, tmp_path / "start.png")


def test_sphere_rolls_to_a_goal_that_is_dragged(session, tmp_path) -> None:
    before = scene_of(session.page, tmp_path / "before.png")
    # Drag the arrow along x by one metre.
    grab, release = (pixel(session.page, (x, 0.0, RADIUS)) for x in (0.5, 1.5))
    session.page.drag(grab, release)
    session.graph.until(lambda: session.goals)
    goal = pose_from_ros(session.goals[-1])
    assert goal[0] == pytest.approx(1.0, abs=0.3) and abs(goal[1]) < 1e-3
    assert abs(goal[2]) == pytest.approx(1.0, abs=1e-3)
    session.graph.until(lambda: state_error(pose_from_ros(session.poses[-1]), goal) < 0.05)
    session.graph.until(
        lambda: np.mean(np.abs(scene_of(session.page, tmp_path / "after.png") - before)) > 1.0
    )


def test_pause_and_resume_reach_the_simulator(session) -> None:
    session.page.click_button("Pause")
    session.page.wait_for("paused")
    session.graph.spin_for(0.5)
    paused_at = session.time
    session.graph.spin_for(1.0)
    assert session.time == paused_at
    session.page.click_button("Resume")
    session.graph.until(lambda: session.time > paused_at)
    session.page.wait_for("live")


def test_controller_recovers_from_a_push(session) -> None:
    goal = pose_from_ros(session.goals[-1])
    session.page.click_button("Push")
    session.graph.until(lambda: state_error(pose_from_ros(session.poses[-1]), goal) > 0.1)
    session.graph.until(lambda: state_error(pose_from_ros(session.poses[-1]), goal) < 0.05)


def test_speed_and_strategy_can_be_changed(session) -> None:
    for before, after in (("time_optimal", "paper"), ("paper", "time_optimal")):
        session.page.choose(before, after)
        session.graph.until(
            lambda after=after: session.statuses and session.status["strategy"] == after
        )

    def type_speed(factor: float) -> bool:
        # A page that updates the field meanwhile discards the number; a user then types it again.
        session.page.type_number("speed", str(factor))
        session.graph.spin_for(2.0)
        return session.real_time_factor() == factor

    for factor in (0.5, 2.0):
        session.graph.until(lambda factor=factor: type_speed(factor))


def test_goal_can_be_selected_from_the_list(session) -> None:
    session.page.choose("pick a goal …", "goal of the paper's case 2")
    session.graph.until(
        lambda: state_error(pose_from_ros(session.goals[-1]), PAPER_CASES[2].goal) < 1e-9
    )


def test_viewer_and_page_that_start_late_show_the_present_state(session) -> None:
    session.page.open("about:blank")
    stop([session.processes["viewer"]])
    session.processes["viewer"] = start(session.folder, "viewer", "--port", "0")
    session.graph.until(lambda: page_of(session.folder))
    session.page.open(page_of(session.folder))
    session.page.wait_for("to the goal")
    session.page.wait_for("live")


@pytest.mark.parametrize(
    ("name", "arguments", "alert"),
    [("controller", CONTROLLER, "controller silent for"), ("simulator", SIMULATOR, "no pose for")],
)
def test_killed_node_causes_an_alert_until_it_restarts(session, name, arguments, alert) -> None:
    # The time-outs are tested without a page, see `Liveness`.
    session.processes[name].kill()
    session.page.wait_for(alert)
    session.restart(name, *arguments)
    session.page.wait_for("live")


def test_page_has_logged_no_error(session) -> None:
    assert session.page.console == []
