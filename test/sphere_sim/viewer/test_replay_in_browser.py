# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Replay of a recording in a real browser; the tests depend on their order."""

import re
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser")

from browser import Browser, find_browser
from page_helpers import page_of, scene_of, wait_for_scene
from patience import PATIENCE
from rosbags.typesys import Stores, get_typestore
from verb_process import start, stop

from sphere_sim.recording.bag_writer import BagWriter

BROWSER = find_browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here: apt-get install chromium"),
]
STORE = get_typestore(Stores.ROS2_JAZZY)
POSE, STATUS = "geometry_msgs/msg/PoseStamped", "diagnostic_msgs/msg/DiagnosticStatus"
LENGTH, STEP = 20.0, 0.02
"""Length of the recording and time between its poses [s]; the sphere rolls at 0.2 m/s in x."""


def write_bag(folder: Path, plan: str = "") -> Path:
    """Write the recording, with a controller that reports a solve of this status if it is given.
    """
    kinds, writer = STORE.types, BagWriter(folder)
    writer.add_topic("/pose", POSE)
    for i in range(round(LENGTH / STEP) + 1):
        x = 0.2 * i * STEP
        stamp = 10**9 + round(i * STEP * 1e9)
        header = kinds["std_msgs/msg/Header"](
            kinds["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), "world"
        )
        half = 0.5 * x / 0.3
        message = kinds[POSE](header, kinds["geometry_msgs/msg/Pose"](
            kinds["geometry_msgs/msg/Point"](x, 0.0, 0.3),
            kinds["geometry_msgs/msg/Quaternion"](0.0, np.sin(half), 0.0, np.cos(half)),
        ))
        writer.write("/pose", stamp, bytes(STORE.serialize_cdr(message, POSE)))
    if plan:
        values = {"plan": plan, "solve_time_s": "0.01", "time_s": "1"}
        solve = kinds[STATUS](0, "controller", "", "", [
            kinds["diagnostic_msgs/msg/KeyValue"](key, value) for key, value in values.items()
        ])
        writer.add_topic("/controller/status", STATUS)
        writer.write("/controller/status", 10**9, bytes(STORE.serialize_cdr(solve, STATUS)))
    writer.close()
    return folder


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Iterator[Browser]:
    folder = tmp_path_factory.mktemp("replay")
    bag, home = write_bag(folder / "bag"), folder / "browser"
    home.mkdir()
    viewer = start(folder, "viewer", "--port", "0", "--replay", str(bag))
    try:
        end = time.monotonic() + PATIENCE
        while not page_of(folder):
            log = (folder / "viewer.log").read_text()
            assert time.monotonic() < end and viewer.poll() is None, log
            time.sleep(0.1)
        with Browser(BROWSER, home) as browser:
            browser.open(page_of(folder))
            yield browser
    finally:
        stop([viewer])


def shown(page: Browser) -> float:
    """Return the time the page shows [s]."""
    return float(re.search(r"t = ([\d.]+) s", page.text).group(1))


def wait_until(condition) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "time-out"
        time.sleep(0.1)


def test_recording_plays_to_its_end_and_stops(page, tmp_path) -> None:
    page.wait_for("recording")
    page.settle()
    wait_for_scene(page, tmp_path / "scene.png")
    page.wait_for("recording, stopped")
    wait_until(lambda: shown(page) == pytest.approx(LENGTH, abs=0.01))


def test_slider_seeks_a_time(page, tmp_path) -> None:
    at_the_end = scene_of(page, tmp_path / "end.png")
    ((left, top, width, height),) = page.boxes(".mantine-Slider-track")
    middle = top + 0.5 * height
    page.drag((left + 0.99 * width, middle), (left + 0.25 * width, middle))
    wait_until(lambda: shown(page) == pytest.approx(0.25 * LENGTH, abs=0.1 * LENGTH))
    chosen = shown(page)
    time.sleep(1.0)
    assert shown(page) == chosen, "time is still paused"
    # A slow page draws the scene later.
    wait_until(
        lambda: np.mean(np.abs(scene_of(page, tmp_path / "then.png") - at_the_end)) > 0.5
    )


def test_playback_continues_from_there(page) -> None:
    began = shown(page)
    page.click_button("Play")
    wait_until(lambda: began < shown(page) < LENGTH)
    page.click_button("Pause")
    page.wait_for("recording, stopped")


def test_page_has_logged_no_error(page) -> None:
    assert page.console == []
