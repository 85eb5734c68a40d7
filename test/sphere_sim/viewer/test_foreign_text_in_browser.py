# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Text of other programs on a page, live, in replay and in a report, is text in a real browser."""

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser import Browser, find_browser
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from page_helpers import page_of
from ros_graph import Graph
from std_srvs.srv import Trigger
from test_replay_in_browser import wait_until, write_bag
from verb_process import start, stop, verb_command

from sphere_nmpc.model.state import make_state
from sphere_nmpc.ros.messages import pose_to_ros

BROWSER = find_browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here: apt-get install chromium"),
]
LURE = (
    '<img src=x onerror="ran=1"><iframe srcdoc="<script>parent.ran=1</script>"></iframe>'
    "![](http://a.example/b.png) **bold** <b>tag</b>"
)


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Browser]:
    home = tmp_path / "browser"
    home.mkdir()
    with Browser(BROWSER, home, (1000, 800)) as page:
        yield page


def nothing_of_it_ran(page: Browser) -> None:
    assert page.evaluate("window.ran === undefined")
    assert page.evaluate("document.querySelectorAll('iframe, img[src=\"x\"]').length") == 0
    assert not [url for url in page.requested if "a.example" in url or url.endswith("/x")]


def test_text_of_a_bag_is_shown_as_text(page, tmp_path) -> None:
    bag = write_bag(tmp_path / "bag", LURE)
    viewer = start(tmp_path, "viewer", "--port", "0", "--replay", str(bag))
    try:
        wait_until(lambda: page_of(tmp_path))
        page.open(page_of(tmp_path))
        page.wait_for("recording")
        page.wait_for("t = ")
        page.wait_for(LURE)
        nothing_of_it_ran(page)
    finally:
        stop([viewer])


def test_text_of_bags_is_text_in_a_report(page, tmp_path) -> None:
    named = r'<img src=x onerror="ran=1"><b>$\fail{$'  # which is no formula, either
    bags = [write_bag(tmp_path / name, LURE) for name in ("bag", named)]
    command = verb_command("report", *map(str, bags), "--out", str(tmp_path / "report"))
    done = subprocess.run(command, capture_output=True, text=True, timeout=120.0)
    assert done.returncode == 0, done.stderr
    page.open((tmp_path / "report" / "report.html").as_uri())
    page.wait_for(named)
    page.wait_for("sphere_nmpc")
    nothing_of_it_ran(page)


def test_text_of_the_network_is_shown_as_text(graph: Graph, page, tmp_path) -> None:
    def refuse(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = False, f"refused {LURE}"
        return response

    graph.probe.create_service(Trigger, "simulator/reset", refuse)
    statuses = graph.probe.create_publisher(DiagnosticStatus, "controller/status", 1)
    poses = graph.probe.create_publisher(PoseStamped, "pose", 10)
    values = {"mode": LURE, "strategy": LURE, "giving_up": f"up {LURE}", "no_progress": LURE}
    status = DiagnosticStatus(values=[KeyValue(key=it, value=values[it]) for it in values])
    pose = pose_to_ros(make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), 10**9, 0.3)
    viewer = start(tmp_path, "viewer", "--port", "0")

    def shown(text: str, times: int = 1) -> None:
        """Publish until the page has a text; its notifications are hidden in tests."""
        graph.until(
            lambda: statuses.publish(status) or poses.publish(pose)
            or str(page.evaluate("document.body.textContent")).count(text) >= times
        )

    try:
        graph.until(lambda: page_of(tmp_path))
        page.open(page_of(tmp_path))
        shown(f"up {LURE}")  # among the alerts
        shown(LURE, 3)  # and again, with the mode
        assert page.evaluate(
            "[...document.querySelectorAll('input')].some(e => e.value.startsWith('<img src=x'))"
        ), "the strategy is the choice of a list"
        page.click_button("Reset")
        shown(f"refused {LURE}")
        pose.header.frame_id = LURE
        shown("pose refused: frame: given ")
        nothing_of_it_ran(page)
    finally:
        stop([viewer])
