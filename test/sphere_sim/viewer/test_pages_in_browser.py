# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Pages in a real browser without a robot: access, replay, and text of other programs."""

import json
import re
import subprocess
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser import Browser
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from page_helpers import page_of, scene_of, wait_for_scene
from patience import PATIENCE
from recorded_bags import rolling_messages, write_own
from ros_graph import Graph
from std_srvs.srv import Trigger
from test_access import PROTOCOL
from verb_process import start, stop, verb_command

from sphere_nmpc.model.state import make_state
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_sim.viewer.server import LocalServer

pytestmark = pytest.mark.slow
LENGTH = 10.0
"""Length of the recording [s]."""
LURE = (
    '<img src=x onerror="ran=1"><iframe srcdoc="<script>parent.ran=1</script>"></iframe>'
    "![](http://a.example/b.png) **bold** <b>tag</b>"
)
CONNECT = """<script>
const socket = new WebSocket(%s, %s);
socket.onopen = () => document.body.append("it is open");
socket.onerror = () => document.body.append("it is closed");
</script><body></body>"""


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    server = LocalServer(0)
    server.gui.add_markdown("this is the panel")
    yield server
    server.stop()


def test_page_loads_and_reloads_under_both_names(server, page) -> None:
    for address in (server.url, server.url.replace("127.0.0.1", "localhost")):
        page.open(address)
        page.wait_for("this is the panel")
        page.evaluate("document.body.append('stale')")
        page.call("Page.reload")
        page.wait(lambda: "stale" not in page.text and "this is the panel" in page.text)
        assert server.get_clients()
    assert page.console == []


@pytest.mark.parametrize("knows_token", [False, True])
def test_page_of_another_site_cannot_connect(server, page, knows_token) -> None:
    port, query = urlsplit(server.url).port, urlsplit(server.url).query
    socket = f"ws://127.0.0.1:{port}/" + (f"?{query}" if knows_token else "")
    lure = (CONNECT % (json.dumps(socket), json.dumps(PROTOCOL))).encode()

    class Evil(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(lure)

        def log_message(self, *about: object) -> None:
            pass

    before = set(server.get_clients())
    with ThreadingHTTPServer(("127.0.0.1", 0), Evil) as site:
        threading.Thread(target=site.serve_forever, daemon=True).start()
        page.open(f"http://127.0.0.1:{site.server_port}/")
        page.wait_for("it is ")
        assert "it is closed" in page.text
        site.shutdown()
    page.open(server.url.partition("?")[0])
    page.wait_for("open the address that the viewer printed")
    assert set(server.get_clients()) <= before


def nothing_of_it_ran(page: Browser) -> None:
    assert page.evaluate("window.ran === undefined")
    assert page.evaluate("document.querySelectorAll('iframe, img[src=\"x\"]').length") == 0
    assert not [url for url in page.requested if "a.example" in url or url.endswith("/x")]


def test_recording_plays_to_its_end_seeks_and_continues(page, tmp_path) -> None:
    bag = write_own(tmp_path / "bag", rolling_messages(LENGTH, LURE))
    viewer = start(tmp_path, "viewer", "--port", "0", "--replay", str(bag))

    def shown() -> float:
        """Return the time that the page shows [s]."""
        return float(re.search(r"t = ([\d.]+) s", page.text).group(1))

    try:
        page.wait(lambda: page_of(tmp_path))
        page.open(page_of(tmp_path))
        page.wait_for("recording")
        page.settle()
        wait_for_scene(page, tmp_path / "scene.png")
        page.wait_for("recording, stopped")
        page.wait(lambda: shown() == pytest.approx(LENGTH, abs=0.01))
        page.wait_for(LURE)  # a text of the bag is shown as text
        nothing_of_it_ran(page)

        at_the_end = scene_of(page, tmp_path / "end.png")
        ((left, top, width, height),) = page.boxes(".mantine-Slider-track")
        middle = top + 0.5 * height
        page.drag((left + 0.99 * width, middle), (left + 0.25 * width, middle))
        page.wait(lambda: shown() == pytest.approx(0.25 * LENGTH, abs=0.1 * LENGTH))
        # A slow page draws the scene later.
        page.wait(
            lambda: np.mean(np.abs(scene_of(page, tmp_path / "then.png") - at_the_end)) > 0.5
        )
        chosen = shown()
        page.click_button("Play")
        page.wait(lambda: chosen < shown() < LENGTH)
        page.click_button("Pause")
        page.wait_for("recording, stopped")
        assert page.console == []
    finally:
        stop([viewer])


def test_text_of_bags_is_text_in_a_report(page, tmp_path) -> None:
    named = r'<img src=x onerror="ran=1"><b>$\fail{$'  # which is no formula, either
    bags = [write_own(tmp_path / name, rolling_messages(plan=LURE)) for name in ("bag", named)]
    command = verb_command("report", *map(str, bags), "--out", str(tmp_path / "report"))
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
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
