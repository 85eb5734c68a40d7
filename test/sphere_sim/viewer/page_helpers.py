# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Page of a viewer under test, and the scene on it."""

import io
import re
from pathlib import Path

import numpy as np
from browser import Browser
from PIL import Image

from sphere_sim.viewer.scene import CAMERA, LOOK_AT


def page_of(folder: Path) -> str:
    """Return the address that a viewer has printed; empty before."""
    found = re.search(r"http://\S+", (folder / "viewer.log").read_text(encoding="utf-8"))
    return found.group() if found else ""


def pixel(page: Browser, point: tuple[float, float, float]) -> tuple[float, float]:
    """Return the pixel of a point [m; world frame] in the initial view."""
    left, top, width, height = page.box("canvas")
    camera, forward = np.array(CAMERA), np.array(LOOK_AT) - np.array(CAMERA)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    ray = np.array(point) - camera
    scale = 0.5 * height / np.tan(np.radians(45.0) / 2.0) / float(ray @ forward)
    return (
        left + 0.5 * width + scale * float(ray @ right),
        top + 0.5 * height - scale * float(ray @ up),
    )


def scene_of(page: Browser, path: Path) -> np.ndarray:
    """Return the pixels of the scene, shape (height, width, 3)."""
    left, top, width, height = map(int, page.box("canvas"))
    picture = Image.open(io.BytesIO(page.screenshot(path))).convert("RGB")
    return np.asarray(picture.crop((left, top, left + width, top + height)), dtype=float)


def wait_for_red(page: Browser, path: Path, place: tuple[float, float]) -> None:
    """Wait until a pixel of the page is red, as arrows along x are once they are drawn."""
    left, top, _, _ = map(int, page.box("canvas"))

    def is_red() -> bool:
        red, green, _ = scene_of(page, path)[int(place[1]) - top, int(place[0]) - left]
        return bool(red - green > 100.0)

    page.wait(is_red, "no arrow is drawn there")


def wait_for_scene(page: Browser, path: Path) -> None:
    """Wait until the scene is drawn."""
    page.wait(lambda: np.std(scene_of(page, path)) > 5.0, "the scene is empty")
