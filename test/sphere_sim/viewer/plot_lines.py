# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Lines of a plot on the page, read from its pixels."""

import json
from collections.abc import Sequence

import numpy as np
from browser import Browser

from sphere_sim.viewer.colours import Colour

_WIDTH = 20
"""Part of the plot that is read, at its right end [px]."""


def line_ends(page: Browser, title: str, colours: Sequence[Colour]) -> np.ndarray | None:
    """Return the rows of the ends of lines, from the top [px]; None where one is not drawn.

    Parameters
    ----------
    page : Browser
        The page.
    title : str
        Title of the plot.
    colours : sequence of Colour
        Colours of the lines.
    """
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
