# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is occupied on the floor of the scene, as low walls."""

import numpy as np
import viser

from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.state import Vector
from sphere_sim.output import colours
from sphere_sim.output.floor_shapes import bordered, outlines
from sphere_sim.viewer.geometry import Mesh

_HEIGHT = 0.4
"""Height of the walls over the radius: the sphere behind them stays visible."""
_SIDES = [[k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k] for k in range(4)]
_QUADS = np.array([[4, 5, 6, 7], *_SIDES])
"""Corners of the faces of a block: those on the ground first. It is not seen from below."""


class Walls:
    """Walls around the floor, and on what is occupied there; one mesh, sent when it changes."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._mesh: viser.MeshHandle | None = None
        self._shown: tuple[Grid | None, float] = None, 0.0

    def show(self, floor: Grid | None, radius: float) -> None:
        """Show the walls of a floor for a sphere of a radius [m]; none where it is None."""
        before, self._shown = self._shown, (floor, radius)
        if floor is before[0] and (floor is None or radius == before[1]):
            return
        if self._mesh is not None:
            self._mesh.remove()
            self._mesh = None
        if floor is not None:
            mesh = blocks(outlines(bordered(floor)), _HEIGHT * radius)
            self._mesh = self._scene.add_mesh_simple(
                "/walls", mesh.vertices, mesh.faces, color=colours.WALL, flat_shading=True,
                cast_shadow=False, receive_shadow=False,
            )


def blocks(outlines: Vector, height: float) -> Mesh:
    """Return blocks of a height [m] on outlines with four corners, shape (n, 4, 2) [m]."""
    count = len(outlines)
    vertices = np.zeros((count, 8, 3), dtype=np.float32)
    vertices[:, :4, :2] = vertices[:, 4:, :2] = outlines
    vertices[:, 4:, 2] = height
    triangles = np.concatenate((_QUADS[:, [0, 1, 2]], _QUADS[:, [0, 2, 3]]))
    faces = triangles + 8 * np.arange(count)[:, None, None]
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3).astype(np.uint32))
