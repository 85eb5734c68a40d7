# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Floor with a grid, and the lights of the scene."""

import numpy as np
import viser

from sphere_nmpc.model.state import Vector
from sphere_sim.viewer.colours import Colour, linear
from sphere_sim.viewer.geometry import Mesh

_CELLS = 12
"""Cells of the grid from the middle of the floor to its edge."""
_PLAIN: Colour = (240, 242, 244)
_FINE: Colour = (218, 223, 228)
_COARSE: Colour = (184, 192, 200)


def add_floor(scene: viser.SceneApi, cell: float) -> viser.FrameHandle:
    """Add the floor, with every other line stronger.

    Parameters
    ----------
    scene : viser.SceneApi
        The scene.
    cell : float
        Spacing of the grid [m].

    Returns
    -------
    viser.FrameHandle
        Frame that moves the floor.
    """
    frame = scene.add_frame("/floor", show_axes=False)
    half = _CELLS * cell
    plane = _plane(half)
    scene.add_mesh_simple(
        "/floor/plane", plane.vertices, plane.faces, color=_PLAIN, cast_shadow=False,
        position=(0.0, 0.0, -0.004 * cell), receive_shadow=False,
    )
    places = cell * np.arange(-_CELLS, _CELLS + 1, dtype=np.float64)
    for name, chosen, colour, width in (
        ("fine", places[1::2], _FINE, 1.0), ("coarse", places[::2], _COARSE, 1.5)
    ):
        scene.add_line_segments(
            f"/floor/{name}", _lines(chosen, half), linear(colour),
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
