# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings in a real browser, and texts of other programs."""

import re

import numpy as np
import pytest

pytest.importorskip("viser")

from browser import Browser, page_of, pixel, scene_of, wait_for_scene
from pages import Script
from recorded_bags import rolling_messages, write_own
from verb_process import start, stop

from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.state import make_state
from sphere_sim.cli.report import main
from sphere_sim.report import report_files
from sphere_sim.viewer.scene import LOOK_AT
from sphere_sim.viewer.source import Capabilities, Frame
from sphere_sim.viewer.viewer import Viewer

pytestmark = pytest.mark.slow
LENGTH = 10.0
"""Length of the recording [s]."""
LURE = (
    '<img src=x onerror="ran=1"><iframe srcdoc="<script>parent.ran=1</script>"></iframe>'
    "![](http://a.example/b.png) **bold** <b>tag</b>"
)


def nothing_of_it_ran(page: Browser) -> None:
    assert page.evaluate("window.ran === undefined")
    assert page.evaluate("document.querySelectorAll('iframe, img[src=\"x\"]').length") == 0
    assert not [url for url in page.requested if "a.example" in url or url.endswith("/x")]


def test_recording_plays_to_its_end_seeks_and_continues(page, tmp_path) -> None:
    bag = write_own(tmp_path / "bag", rolling_messages(LENGTH))
    viewer = start(tmp_path, "viewer", "--port", "0", "--replay", str(bag))

    def shown() -> float:
        """Return the time that the page shows [s]."""
        return float(re.search(r"t = ([\d.]+) s", page.text).group(1))

    try:
        page.wait(lambda: page_of(tmp_path))
        # With the address anybody on this machine could send goals.
        assert (tmp_path / "viewer.log").stat().st_mode & 0o077 == 0
        page.open(page_of(tmp_path))
        page.wait_for("recording")
        wait_for_scene(page, tmp_path / "scene.png")
        page.wait_for("recording, stopped")
        page.wait(lambda: shown() == pytest.approx(LENGTH, abs=0.01))
        at_the_end = scene_of(page, tmp_path / "end.png")
        left, top, width, height = page.box(".mantine-Slider-track")
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


def test_walls_are_drawn_where_the_floor_is_occupied_and_go_with_it(page, tmp_path) -> None:
    cells = np.zeros((40, 40), dtype=bool)
    cells[20, 20] = True
    # The cell is where a new page looks at; the others are towards the camera and away from it.
    place, beside = np.array([*LOOK_AT[:2], 0.12]), np.array([0.4, -0.4, -0.12])
    floor = Grid(cells, 0.2, (LOOK_AT[0] - 4.1, LOOK_AT[1] - 4.1, 0.0))
    script, state = Script(), make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    script.next = [Frame(state=state, floor=floor, clearance=0.25)]
    viewer = Viewer(script, 0, live=True)

    def brightness(point: np.ndarray) -> float:
        left, top, _, _ = map(int, page.box("canvas"))
        x, y = pixel(page, tuple(point))
        return float(scene_of(page, tmp_path / "scene.png")[int(y) - top, int(x) - left].mean())

    try:
        page.open(viewer.url)
        page.wait(lambda: viewer.tick() or "clearance of the plan 0.250 m" in page.text)
        wait_for_scene(page, tmp_path / "scene.png")
        page.wait(lambda: brightness(place) < 200.0, "no wall is drawn")
        assert all(brightness(place + side * beside) > 225.0 for side in (1.0, -1.0))
        script.next = [Frame(state=state)]
        page.wait(lambda: viewer.tick() or "clearance" not in page.text)
        page.wait(lambda: brightness(place) > 225.0, "the wall is still drawn")
        assert page.console == []
    finally:
        viewer.close()


def test_text_of_other_programs_is_shown_as_text(page) -> None:
    script, state = Script(), make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    can = Capabilities(reset=True, strategies=("paper", LURE))
    script.next = [
        Frame(state=state, mode=LURE, strategy=LURE, alerts=(f"up {LURE}",), capabilities=can)
    ]
    script.answer = f"refused {LURE}"
    viewer = Viewer(script, 0, live=True)

    def wait_for(text: str, times: int) -> None:
        """Wait until the page has a text; its notifications are hidden in tests."""
        script = "document.body ? document.body.textContent : ''"
        page.wait(lambda: viewer.tick() or page.evaluate(script).count(text) >= times)

    try:
        page.open(viewer.url)
        wait_for(f"up {LURE}", 1)  # among the alerts
        wait_for(LURE, 3)  # and again, with the mode
        inputs = "[...document.querySelectorAll('input')]"
        choice = f"{inputs}.some(e => e.value.startsWith('<img src=x'))"
        page.wait(
            lambda: viewer.tick() or page.evaluate(choice), "the strategy is not in its list"
        )
        page.click_button("Reset")
        wait_for(f"refused {LURE}", 1)
        nothing_of_it_ran(page)
    finally:
        viewer.close()


def test_text_of_bags_is_text_in_a_report(page, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(report_files, "FIGURES", {})  # the comparison names the bags
    named = r'<img src=x onerror="ran=1"><b>$\fail{$'  # which is no formula, either
    bags = [write_own(tmp_path / name, rolling_messages(plan=LURE)) for name in ("bag", named)]
    assert main([*map(str, bags), "--out", str(tmp_path / "report")]) == 0
    page.open((tmp_path / "report" / "report.html").as_uri())
    page.wait_for(named)
    page.wait_for("sphere_nmpc")
    nothing_of_it_ran(page)
