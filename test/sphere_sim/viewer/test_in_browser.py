# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Viewer in a real browser, with real nodes over DDS; the tests depend on their order."""

import re
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser import find_browser
from page_helpers import page_of, pixel, scene_of, wait_for_red, wait_for_scene
from session import CONTROLLER, Session, open_session
from verb_process import start, stop

from sphere_nmpc.model.state import state_error
from sphere_sim.scenario.scenarios import PAPER_CASES

BROWSER = find_browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here: apt-get install chromium"),
]
SIMULATOR = (
    "-p", "initial_state:=[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]", "-p", "real_time_factor:=2.0",
)
RADIUS = 0.3


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Iterator[Session]:
    with open_session(BROWSER, tmp_path_factory.mktemp("session"), SIMULATOR) as session:
        yield session


def test_page_loads_without_errors_or_other_hosts(session, tmp_path) -> None:
    session.page.wait_for("live")
    assert session.page.console == []
    own = re.compile(r"http://127\.0\.0\.1|data:|blob:")
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
    goal = session.goal
    assert goal[0] == pytest.approx(1.0, abs=0.3) and abs(goal[1]) < 1e-3
    assert abs(goal[2]) == pytest.approx(1.0, abs=1e-3)
    session.graph.until(lambda: session.error < 0.05)
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


def test_speed_and_strategy_can_be_changed(session) -> None:
    for before, after in (("time_optimal", "paper"), ("paper", "time_optimal")):
        session.page.choose(before, after)
        session.graph.until(
            lambda after=after: session.statuses and session.status["strategy"] == after
        )

    for factor in (0.5, 2.0):
        session.page.type_number("speed", str(factor))
        session.graph.until(lambda factor=factor: session.real_time_factor() == factor)


def test_goal_can_be_selected_from_the_list(session) -> None:
    session.page.choose("pick a goal …", "goal of the paper's case 2")
    session.graph.until(lambda: state_error(session.goal, PAPER_CASES[2].goal) < 1e-9)


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
