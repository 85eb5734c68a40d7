# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Page of a viewer under test, and the scene and the plots on it."""

import io
import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from browser import Browser
from PIL import Image

from sphere_sim.viewer.colours import Colour
from sphere_sim.viewer.scene import CAMERA, LOOK_AT

_WIDTH = 20
"""Part of the plot that is read, at its right end [px]."""


def page_of(folder: Path) -> str:
    """Return the address that a viewer has printed; empty before."""
    found = re.search(r"http://\S+", (folder / "viewer.log").read_text(encoding="utf-8"))
    return found.group() if found else ""


def canvas(page: Browser) -> tuple[float, float, float, float]:
    """Return left, top, width and height of the scene [px]."""
    script = (
        "(() => { const r = [...document.querySelectorAll('canvas')]"
        ".map(c => c.getBoundingClientRect()).sort((a, b) => b.width * b.height -"
        " a.width * a.height)[0]; return [r.x, r.y, r.width, r.height]; })()"
    )
    return tuple(page.evaluate(script))


def pixel(page: Browser, point: tuple[float, float, float]) -> tuple[float, float]:
    """Return the pixel of a point [m; world frame] in the initial view."""
    left, top, width, height = canvas(page)
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
    left, top, width, height = map(int, canvas(page))
    picture = Image.open(io.BytesIO(page.screenshot(path))).convert("RGB")
    return np.asarray(picture.crop((left, top, left + width, top + height)), dtype=float)


def wait_for_red(page: Browser, path: Path, place: tuple[float, float]) -> None:
    """Wait until a pixel of the page is red, as arrows along x are once they are drawn."""
    left, top, _, _ = map(int, canvas(page))

    def is_red() -> bool:
        red, green, _ = scene_of(page, path)[int(place[1]) - top, int(place[0]) - left]
        return bool(red - green > 100.0)

    page.wait(is_red, "no arrow is drawn there")


def wait_for_scene(page: Browser, path: Path) -> None:
    """Wait until the scene is drawn."""
    page.wait(lambda: np.std(scene_of(page, path)) > 5.0, "the scene is empty")


def line_ends(page: Browser, title: str, colours: Sequence[Colour]) -> np.ndarray | None:
    """Return the rows of the ends of a plot's lines, from the top [px]; None if one is missing."""
    script = (
        f"(() => {{ const t = [...document.querySelectorAll('.u-title')]"
        f".find(e => e.innerText.trim() === {json.dumps(title)}); if (!t) return null;"
        " const plot = t.closest('.uplot'), c = plot.querySelector('canvas'),"
        " r = c.getBoundingClientRect(), o = plot.querySelector('.u-over')"
        ".getBoundingClientRect(), s = c.width / r.width;"
        f" const w = Math.round({_WIDTH} * s), h = Math.round(o.height * s);"
        " const d = c.getContext('2d').getImageData((o.right - r.left) * s - w,"
        " (o.top - r.top) * s, w, h).data;"
        " return [h, w, [...d]]; })()"
    )
    drawn = page.evaluate(script)
    if drawn is None:
        return None
    height, width, values = drawn
    pixels = np.reshape(values, (height, width, 4))
    rows = [np.nonzero(_has_colour(pixels, colour).any(axis=1))[0] for colour in colours]
    return np.array([np.mean(row) for row in rows]) if all(map(len, rows)) else None


def _has_colour(pixels: np.ndarray, colour: Colour) -> np.ndarray:
    """Return where opaque pixels have a colour, within rounding."""
    close = np.abs(pixels[..., :3] - np.array(colour)).max(axis=-1) <= 2
    return close & (pixels[..., 3] == 255)
