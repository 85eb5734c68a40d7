# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals of a real browser: points that are clicked, and the buttons for the way to the goal."""

import pytest

pytest.importorskip("viser")

from browser import pixel, wait_for_scene
from pages import Script

from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.state import make_state
from sphere_sim.viewer.source import Cancel, Capabilities, Enable, Frame, SetPoint
from sphere_sim.viewer.viewer import Viewer

pytestmark = pytest.mark.slow


def test_click_on_the_floor_sends_a_point_and_buttons_act_on_the_way(page, tmp_path) -> None:
    script = Script()
    state = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    script.next = [Frame(state=state, goal=Goal(state), capabilities=Capabilities(stop=True))]
    viewer = Viewer(script, 0, live=True)

    def wait_for(*expected: object) -> None:
        page.wait(lambda: viewer.tick() or len(script.requests) >= len(expected))
        assert script.requests == [*expected]
        script.requests.clear()

    def wait_for_pointer(shown: bool) -> None:
        """Wait until the page shows by its mouse pointer whether clicks have an effect."""
        pointer = (
            "[...document.querySelectorAll('canvas')].some(e => e.style.cursor === 'pointer')"
        )
        page.wait(lambda: viewer.tick() or page.evaluate(pointer) is shown, "the mouse pointer")

    try:
        viewer.tick()
        page.open(viewer.url)
        page.wait(lambda: viewer.tick() or "Cancel" in page.text)
        wait_for_scene(page, tmp_path / "start.png")
        for button, request in (
            ("Stop", Enable(False)), ("Continue", Enable(True)), ("Cancel", Cancel())
        ):
            page.click_button(button)
            wait_for(request)

        place = pixel(page, (0.8, -0.9, 0.0))
        page.click(place)  # not enabled yet: nothing comes of it
        page.check("point by click")
        wait_for_pointer(True)
        assert script.requests == []
        page.click(place)
        page.wait(lambda: viewer.tick() or script.requests)
        (sent,) = script.requests
        assert isinstance(sent, SetPoint)
        assert sent.position == pytest.approx((0.8, -0.9), abs=0.05)
        script.requests.clear()

        page.drag(place, (place[0] + 60.0, place[1]))  # turns the view
        page.check("point by click")
        wait_for_pointer(False)
        page.click(place)
        page.click_button("Stop")
        wait_for(Enable(False))
        assert page.console == []
    finally:
        viewer.close()
