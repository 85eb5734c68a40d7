# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The floor, a plane with lines half a metre apart, and the light on it."""

import numpy as np
import viser

from sphere_nmpc.model.state import Vector
from sphere_sim.viewer.colours import Colour, as_light
from sphere_sim.viewer.geometry import Mesh

_HALF = 6.0
"""Half the width [m]."""
_CELL = 0.5
"""Distance of two lines [m]."""
_PLAIN: Colour = (240, 242, 244)
_FINE: Colour = (218, 223, 228)
_COARSE: Colour = (184, 192, 200)


def add_floor(scene: viser.SceneApi) -> viser.FrameHandle:
    """Draw the floor; whole metres have stronger lines.

    Returns
    -------
    viser.FrameHandle
        What moves it.
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
            f"/floor/{name}", _lines(chosen, _HALF), as_light(colour),
            thickness=width,
            thickness_units="screen",
        )
    return frame


def add_lights(scene: viser.SceneApi) -> None:
    """Light the scene evenly from above, and from one side to give shapes.

    Plain lights that cast no shadows: who watches a robot often has no graphics card, and shadows
    cost its processor more than everything else in the picture.
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
    """Return lines along x and along y at these places, shape (2 n, 2, 3)."""
    n = len(places)
    lines = np.zeros((2 * n, 2, 3))
    lines[:n, :, 0], lines[n:, :, 1] = (-half, half), (-half, half)
    lines[:n, :, 1], lines[n:, :, 0] = places[:, None], places[:, None]
    return lines
