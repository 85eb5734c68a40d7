# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Floor with a grid of half a metre, and the lights of the scene."""

import numpy as np
import viser

from sphere_nmpc.model.state import Vector
from sphere_sim.viewer.colours import Colour, linear
from sphere_sim.viewer.geometry import Mesh

_HALF = 6.0
"""Half the width of the floor [m]."""
_CELL = 0.5
"""Spacing of the grid [m]."""
_PLAIN: Colour = (240, 242, 244)
_FINE: Colour = (218, 223, 228)
_COARSE: Colour = (184, 192, 200)


def add_floor(scene: viser.SceneApi) -> viser.FrameHandle:
    """Add the floor, with stronger lines at whole metres.

    Returns
    -------
    viser.FrameHandle
        Frame that moves the floor.
    """
    frame = scene.add_frame("/floor", show_axes=False)
    plane = _plane(_HALF)
    scene.add_mesh_simple(
        "/floor/plane", plane.vertices, plane.faces, color=_PLAIN, cast_shadow=False,
        position=(0.0, 0.0, -0.002), receive_shadow=False,
    )
    number = round(_HALF / _CELL)
    places = _CELL * np.arange(-number, number + 1, dtype=np.float64)
    whole = np.isclose(places, np.round(places))
    for name, chosen, colour, width in (
        ("fine", places[~whole], _FINE, 1.0), ("coarse", places[whole], _COARSE, 1.5)
    ):
        scene.add_line_segments(
            f"/floor/{name}", _lines(chosen, _HALF), linear(colour),
            thickness=width,
            thickness_units="screen",
        )
    return frame


def add_lights(scene: viser.SceneApi) -> None:
    """Add uniform light from above, and directional light that makes shapes visible.

    The lights cast no shadows: without a graphics card, these would take more processor time than
    all the rest of the scene.
    """
    scene.configure_default_lights(enabled=False)
    scene.add_light_hemisphere(
        "/light/sky", sky_color=(255, 255, 255), ground_color=(190, 195, 200), intensity=2.0
    )
    scene.add_light_directional(
        "/light/lamp", intensity=1.8, position=(2.0, -3.0, 5.0), cast_shadow=False
    )


def _plane(half: float) -> Mesh:
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float32)
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32))


def _lines(places: Vector, half: float) -> Vector:
    """Return lines along x and y at these n coordinates [m], shape (2 n, 2, 3)."""
    n = len(places)
    lines = np.zeros((2 * n, 2, 3))
    lines[:n, :, 0], lines[n:, :, 1] = (-half, half), (-half, half)
    lines[:n, :, 1], lines[n:, :, 0] = places[:, None], places[:, None]
    return lines
