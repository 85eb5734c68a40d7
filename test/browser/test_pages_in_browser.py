# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Pages of given frames and of recordings in a real browser, and texts of other programs."""

import re
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("viser")

from browser import Browser, colour, pixel, scene_of
from pages import Script
from recorded_bags import rolling_messages, write_own
from verb_process import page_of, start

from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.state import make_state
from sphere_nmpc.process.child import stop_together
from sphere_sim.cli.report import main
from sphere_sim.report import report_files
from sphere_sim.viewer.scene import LOOK_AT
from sphere_sim.viewer.source import Cancel, Capabilities, Enable, Frame, SetPath, SetPoint
from sphere_sim.viewer.viewer import Viewer

pytestmark = pytest.mark.slow
STATE = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
LENGTH = 10.0
"""Length of the recording [s]."""
LURE = (
    '<img src=x onerror="ran=1"><iframe srcdoc="<script>parent.ran=1</script>"></iframe>'
    "![](http://a.example/b.png) **bold** <b>tag</b>"
)


@pytest.fixture
def script() -> Script:
    return Script()


@pytest.fixture
def shown(script, page) -> Iterator[Browser]:
    """Return the page of a viewer of the script."""
    viewer = Viewer(script, 0, live=True)
    page.meanwhile = viewer.tick
    page.open(viewer.url)
    yield page
    viewer.close()


def wait_for_pointer(page: Browser, shown: bool) -> None:
    """Wait until the page shows by its mouse pointer whether the mouse has an effect."""
    pointer = "[...document.querySelectorAll('canvas')].some(e => e.style.cursor === 'pointer')"
    page.wait(lambda: page.evaluate(pointer) is shown, "the mouse pointer")


def test_click_on_the_floor_sends_a_point_and_buttons_act_on_the_way(shown, script) -> None:
    page = shown
    script.next = [Frame(state=STATE, goal=Goal(STATE), capabilities=Capabilities(stop=True))]

    def next_request() -> object:
        page.wait(lambda: script.requests)
        (request,) = script.requests
        script.requests.clear()
        return request

    page.wait_for("Cancel")
    scene_of(page)
    for button, request in (
        ("Stop", Enable(False)), ("Continue", Enable(True)), ("Cancel", Cancel())
    ):
        page.click_button(button)
        assert next_request() == request
    place = pixel(page, (0.8, -0.9, 0.0))
    page.click(place)  # not enabled yet: nothing comes of it
    page.check("point by click")
    wait_for_pointer(page, True)
    assert script.requests == []
    page.click(place)
    sent = next_request()
    assert isinstance(sent, SetPoint)
    assert sent.position == pytest.approx((0.8, -0.9), abs=0.05)
    page.drag(place, (place[0] + 60.0, place[1]))  # turns the view
    page.check("point by click")
    wait_for_pointer(page, False)
    page.click(place)
    page.click_button("Stop")
    assert next_request() == Enable(False)
    assert page.console == []


def test_path_is_drawn_with_the_mouse_on_the_floor(shown, script) -> None:
    page, begin, end = shown, np.array([0.8, -0.9]), np.array([1.4, -1.5])
    script.next = [Frame(state=STATE, goal=Goal(STATE))]
    page.wait_for("draw a path")
    page.check("draw a path")
    page.settle()
    pixels = [pixel(page, (*place, 0.0)) for place in (begin, end)]

    page._mouse("mouseMoved", *pixels[0])
    wait_for_pointer(page, True)
    page.drag(*pixels, steps=12)
    page.wait(lambda: script.requests)
    (sent,) = script.requests
    assert isinstance(sent, SetPath)
    places = np.array(sent.places)
    np.testing.assert_allclose(places[[0, -1]], [begin, end], atol=0.1)
    ahead = (end - begin) / np.linalg.norm(end - begin)
    assert np.all(np.diff(places @ ahead) > 0.0)
    assert np.abs((places - begin) @ (-ahead[1], ahead[0])).max() < 0.05
    # viser calls that from its own handler of the first event.
    assert [it for it in page.console if "preventDefault" not in it] == []


PHONE = 390, 844


def test_phone_shows_more_of_the_scene_than_of_the_panel(shown, script) -> None:
    page, panel = shown, '[style*="max-height: 60%"]'
    script.next = [Frame(state=STATE, goal=Goal(STATE), capabilities=Capabilities(stop=True))]
    page.resize(*PHONE)
    page.wait_for("to the goal")
    page.wait(lambda: page.evaluate(f"!!document.querySelector('{panel}')"), "no panel")
    page.wait(lambda: page.box(panel)[3] == pytest.approx(0.35 * PHONE[1], abs=1.0))
    assert page.evaluate("document.title") == "sphere_nmpc"
    assert page.console == []


def test_figures_of_a_report_are_legible_on_a_phone(page, tmp_path, monkeypatch) -> None:
    panels = {"panels": report_files.FIGURES["panels"]}
    monkeypatch.setattr(report_files, "FIGURES", panels)
    bag = write_own(tmp_path / "bag", rolling_messages())
    assert main([str(bag), "--out", str(tmp_path / "report")]) == 0
    page.resize(*PHONE)
    page.open((tmp_path / "report" / "report.html").as_uri())
    page.wait_for("Made by")
    width = page.box("img")[2]
    # Labels have 9.5 points on a figure of 960 pixels.
    assert width * 9.5 / 0.75 / 960.0 > 9.0
    assert page.evaluate("document.documentElement.scrollWidth") == PHONE[0]


def test_walls_are_drawn_where_the_floor_is_occupied_and_go_with_it(shown, script) -> None:
    page, cells = shown, np.zeros((40, 40), dtype=bool)
    cells[20, 20] = True
    # The cell is where a new page looks at; the others are towards the camera and away from it.
    place, beside = np.array([*LOOK_AT[:2], 0.12]), np.array([0.4, -0.4, -0.12])
    floor = Grid(cells, 0.2, (LOOK_AT[0] - 4.1, LOOK_AT[1] - 4.1, 0.0))
    script.next = [Frame(state=STATE, floor=floor, clearance=0.25)]
    page.wait_for("clearance of the plan 0.250 m")
    scene_of(page)
    page.wait(lambda: colour(page, place).mean() < 200.0, "no wall is drawn")
    assert all(colour(page, place + side * beside).mean() > 225.0 for side in (1.0, -1.0))
    script.next = [Frame(state=STATE)]
    page.wait(lambda: "clearance" not in page.text)
    page.wait(lambda: colour(page, place).mean() > 225.0, "the wall is still drawn")
    assert page.console == []


def test_estimate_is_a_second_sphere_with_its_error_and_goes_with_it(shown, script) -> None:
    page, place = shown, np.array([*LOOK_AT[:2], 0.3])

    def yellow() -> float:
        """Return by how much red and green exceed blue where the estimate is."""
        red, green, blue = colour(page, place)
        return float(min(red, green) - blue)

    script.next = [Frame(
        state=STATE, estimate=make_state(place[:2], (0.5**0.5, 0.0, 0.0, 0.5**0.5)),
        estimate_error=np.array([0.0032, np.radians(-1.2)]),
    )]
    page.wait_for("odometry off by 3.2 mm, -1.20°")
    scene_of(page)
    page.wait(lambda: yellow() > 15.0, f"no estimate is drawn: {yellow()}")
    script.next = [Frame(state=STATE)]
    page.wait(lambda: "odometry" not in page.text)
    page.wait(lambda: yellow() < 5.0, "the estimate is still drawn")
    assert page.console == []


def nothing_of_it_ran(page: Browser) -> None:
    assert page.evaluate("window.ran === undefined")
    assert page.evaluate("document.querySelectorAll('iframe, img[src=\"x\"]').length") == 0
    assert not [url for url in page.requested if "a.example" in url or url.endswith("/x")]


def test_text_of_other_programs_is_shown_as_text(shown, script) -> None:
    page, can = shown, Capabilities(reset=True, strategies=("paper", LURE))
    script.next = [
        Frame(state=STATE, mode=LURE, strategy=LURE, alerts=(f"up {LURE}",), capabilities=can)
    ]
    script.answer = f"refused {LURE}"

    def wait_for(text: str, times: int = 1) -> None:
        """Wait until the page has a text; its notifications are hidden in tests."""
        script = "document.body ? document.body.textContent : ''"
        page.wait(lambda: page.evaluate(script).count(text) >= times)

    wait_for(f"up {LURE}")  # among the alerts
    wait_for(LURE, 3)  # and again, with the mode
    inputs = "[...document.querySelectorAll('input')]"
    choice = f"{inputs}.some(e => e.value.startsWith('<img src=x'))"
    page.wait(lambda: page.evaluate(choice), "the strategy is not in its list")
    page.click_button("Reset")
    wait_for(f"refused {LURE}")
    nothing_of_it_ran(page)


def test_text_of_bags_is_text_in_a_report(page, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(report_files, "FIGURES", {})  # the comparison names the bags
    named = r'<img src=x onerror="ran=1"><b>$\fail{$'  # which is no formula, either
    bags = [write_own(tmp_path / name, rolling_messages(plan=LURE)) for name in ("bag", named)]
    assert main([*map(str, bags), "--out", str(tmp_path / "report")]) == 0
    page.open((tmp_path / "report" / "report.html").as_uri())
    page.wait_for(named)
    page.wait_for("sphere_nmpc")
    nothing_of_it_ran(page)


def test_recording_plays_to_its_end_seeks_and_continues(page, tmp_path) -> None:
    bag = write_own(tmp_path / "bag", rolling_messages(LENGTH))
    viewer = start(tmp_path, "viewer", "--port", "0", "--replay", str(bag))

    def time() -> float:
        """Return the time that the page shows [s]."""
        return float(re.search(r"t = ([\d.]+) s", page.text).group(1))

    try:
        page.wait(lambda: page_of(viewer))
        # With the address anybody on this machine could send goals.
        assert (tmp_path / "viewer.log").stat().st_mode & 0o077 == 0
        page.open(page_of(viewer))
        page.wait_for("recording")
        scene_of(page)
        page.wait_for("recording, stopped")
        page.wait(lambda: time() == pytest.approx(LENGTH, abs=0.01))
        at_the_end = scene_of(page)
        left, top, width, height = page.box(".mantine-Slider-track")
        middle = top + 0.5 * height
        page.drag((left + 0.99 * width, middle), (left + 0.25 * width, middle))
        page.wait(lambda: time() == pytest.approx(0.25 * LENGTH, abs=0.1 * LENGTH))
        # A slow page draws the scene later.
        page.wait(lambda: np.mean(np.abs(scene_of(page) - at_the_end)) > 0.5)
        chosen = time()
        page.click_button("Play")
        page.wait(lambda: chosen < time() < LENGTH)
        page.click_button("Pause")
        page.wait_for("recording, stopped")
        assert page.console == []
    finally:
        stop_together([viewer])
