# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Viewer in a real browser, with real nodes over DDS; the tests depend on their order."""

import math
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser import Browser
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from page_helpers import line_ends, page_of, pixel, scene_of, wait_for_red, wait_for_scene
from rcl_interfaces.srv import GetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import Graph, values_of
from std_msgs.msg import Bool
from verb_process import start, stop

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, state_error
from sphere_nmpc.ros.messages import pose_from_ros, stamp_from_ros
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.viewer import colours

pytestmark = pytest.mark.slow
SIMULATOR = (
    "-p", "initial_state:=[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]", "-p", "real_time_factor:=2.0",
)
CONTROLLER = (
    "-p", "use_sim_time:=true", "-p", "strategy:=time_optimal",
    "-p", "goal_memory:=0.0",  # no goal of a controller of another test
)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RADIUS = RobotParameters().shell_radius
PLOT = "momentum about the contact point, world [N m s]"


@dataclass
class Session:
    """Nodes, page, and a probe in the graph."""

    page: Browser
    graph: Graph
    processes: dict[str, subprocess.Popen]
    folder: Path

    def __post_init__(self) -> None:
        self.poses = self.graph.collect(PoseStamped, "pose", 1)
        self.goals = self.graph.collect(PoseStamped, "controller/active_goal", LATCHED)
        self.statuses = self.graph.collect(DiagnosticStatus, "controller/status", 1)
        self.at_goal = self.graph.collect(Bool, "controller/at_goal", LATCHED)
        self.pushes = self.graph.collect(Vector3Stamped, "simulator/pushed")

    @property
    def time(self) -> int:
        """Stamp of the newest pose [ns]."""
        return stamp_from_ros(self.poses[-1].header.stamp)

    @property
    def goal(self) -> Vector:
        """Goal in force, shape (6,)."""
        return pose_from_ros(self.goals[-1])

    def wait_at_goal(self) -> None:
        """Wait until status and pose agree that the sphere is at the goal."""
        self.graph.until(lambda: self.at_goal and self.at_goal[-1].data and (
            state_error(pose_from_ros(self.poses[-1]), self.goal) < 0.01
        ))

    def open_page(self) -> None:
        self.graph.until(lambda: page_of(self.folder))
        self.page.open(page_of(self.folder))
        self.page.wait_for("live")


@pytest.fixture(scope="module")
def session(browser, tmp_path_factory) -> Iterator[Session]:
    folder = tmp_path_factory.mktemp("session")
    processes = {
        "simulator": start(folder, "simulator", "--ros-args", *SIMULATOR),
        "controller": start(folder, "controller", "--ros-args", *CONTROLLER),
        "viewer": start(folder, "viewer", "--port", "0"),
    }
    graph = Graph()
    try:
        browser.reset()
        session = Session(browser, graph, processes, folder)
        session.open_page()
        yield session
    finally:
        graph.close()
        stop(processes.values())
        for log in sorted(folder.glob("*.log")):  # shown where a test failed
            print(f"{log.name}:\n{log.read_text(errors='replace')[-3000:]}")


def test_page_loads_without_errors_or_other_hosts(session, tmp_path) -> None:
    assert session.page.console == []
    own = re.compile(r"http://127\.0\.0\.1|data:|blob:|about:")
    assert [url for url in session.page.requested if not own.match(url)] == []
    session.page.settle()
    wait_for_scene(session.page, tmp_path / "start.png")


def test_sphere_rolls_to_a_goal_that_is_dragged(session, tmp_path) -> None:
    # Drag the arrow along x by one metre.
    grab, release = (pixel(session.page, (x, 0.0, RADIUS)) for x in (0.5, 1.5))
    wait_for_red(session.page, tmp_path / "arrow.png", grab)
    before = scene_of(session.page, tmp_path / "before.png")
    session.page.drag(grab, release)
    session.graph.until(lambda: session.goals)
    assert session.goal[0] == pytest.approx(1.0, abs=0.3) and abs(session.goal[1]) < 1e-3
    assert abs(session.goal[2]) == pytest.approx(1.0, abs=1e-3)
    session.wait_at_goal()
    session.graph.until(
        lambda: np.mean(np.abs(scene_of(session.page, tmp_path / "after.png") - before)) > 1.0
    )


def test_pushed_sphere_returns_and_the_plot_has_its_momentum(session) -> None:
    angle = math.radians(30.0)
    impulse = 0.6 * np.array([math.cos(angle), math.sin(angle)])
    session.page.type_number("impulse [N s]", "0.6")
    session.page.type_number("direction [°]", "30")
    session.page.click_button("Push")
    session.graph.until(lambda: session.pushes)
    pushed = session.pushes[-1].vector
    np.testing.assert_allclose([pushed.x, pushed.y], impulse, atol=1e-9)
    session.graph.until(lambda: not session.at_goal[-1].data)
    session.wait_at_goal()
    momentum = RADIUS * np.array([-impulse[1], impulse[0]])
    status = values_of(session.statuses[-1])
    found = [float(status[f"momentum_{axis}"]) for axis in "xy"]
    np.testing.assert_allclose(found, momentum, atol=0.01)

    def is_drawn() -> bool:
        """Return whether the newest x and y are on their sides of zero."""
        ends = line_ends(session.page, PLOT, (colours.BLUE, colours.VERMILION, colours.INK))
        return ends is not None and np.array_equal(np.sign(ends[2] - ends[:2]), np.sign(momentum))

    session.graph.until(is_drawn)


def test_pause_and_resume_reach_the_simulator(session) -> None:
    session.page.click_button("Pause")
    session.page.wait_for("paused")
    session.graph.spin_for(0.5)
    paused_at = session.time
    session.graph.spin_for(0.5)
    assert session.time == paused_at
    session.page.click_button("Resume")
    session.graph.until(lambda: session.time > paused_at)
    session.page.wait_for("live")


def test_speed_strategy_and_goal_can_be_chosen(session) -> None:
    session.page.choose("time_optimal", "paper")
    session.graph.until(lambda: values_of(session.statuses[-1])["strategy"] == "paper")

    def factor() -> float:
        request = GetParameters.Request(names=["real_time_factor"])
        answer = session.graph.call(GetParameters, "simulator/get_parameters", request)
        return float(answer.values[0].double_value)

    session.page.type_number("speed", "1.5")
    session.graph.until(lambda: factor() == 1.5)
    session.page.choose("pick a goal …", "goal of the paper's case 2")
    session.graph.until(lambda: state_error(session.goal, PAPER_CASES[2].goal) < 1e-9)


def test_viewer_and_page_that_start_late_show_the_present_state(session) -> None:
    session.page.open("about:blank")
    stop([session.processes["viewer"]])
    session.processes["viewer"] = start(session.folder, "viewer", "--port", "0")
    session.open_page()
    session.page.wait_for("to the goal")


def test_killed_simulator_causes_an_alert_until_it_restarts(session) -> None:
    # The other alerts are tested without a page, see `LiveFrame`.
    session.processes["simulator"].kill()
    session.page.wait_for("no pose for")
    session.processes["simulator"] = start(session.folder, "simulator", "--ros-args", *SIMULATOR)
    session.page.wait_for("live")
    assert session.page.console == []
