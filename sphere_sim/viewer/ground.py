# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What lies on the ground of the scene: floor, world axes, path and plan."""

import numpy as np
import viser

from sphere_nmpc.model.state import POSITION, Vector
from sphere_sim.output.round_numbers import grid_cell
from sphere_sim.viewer import colours
from sphere_sim.viewer.floor import add_floor
from sphere_sim.viewer.geometry import without_repeats
from sphere_sim.viewer.trail import Trail

_ON_FLOOR = 4.0 / 300.0
"""Height of lines on the floor over the size."""
_FLOOR_MARGIN = 7
"""Cells between sphere and middle of the floor from which on the floor follows."""


class Ground:
    """Floor, world axes, path and plan, created for one size.

    Parameters
    ----------
    scene : viser.SceneApi
        The scene; nodes of an earlier ground are replaced.
    size : float
        Radius of a sphere beside which thickness of lines and spacing of the grid are right [m].
    """

    def __init__(self, scene: viser.SceneApi, size: float) -> None:
        self.size = size
        """Radius of the sphere for which it was created [m]."""
        self.cell = grid_cell(size)
        """Spacing of the grid [m]."""
        self._floor = add_floor(scene, self.cell)
        scene.add_frame(
            "/world", axes_length=0.25 / 0.3 * size, axes_radius=0.008 / 0.3 * size,
            origin_radius=0.04 * size, position=(0.0, 0.0, _ON_FLOOR * size),
        )
        self._path = Trail(scene, "/path", colours.PATH, 0.04 * size, size / 30.0)
        self._plan = scene.add_spline_catmull_rom(
            "/plan/line", np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]), color=colours.PLAN,
            thickness=size / 15.0, visible=False,
        )
        self._knots = scene.add_point_cloud(
            "/plan/knots", np.zeros((1, 3)), colours.PLAN, point_size=0.035 / 0.3 * size,
            point_shape="circle", precision="float32", visible=False,
        )
        self._drawn_plan: Vector | None = None

    def clear_path(self) -> None:
        """Delete the path."""
        self._path.clear()

    def extend_path(self, position: Vector) -> None:
        """Extend the path to a position, shape (2,) [m]."""
        self._path.add(np.array([*position, _ON_FLOOR * self.size]))

    def show(self, position: Vector, plan: Vector) -> None:
        """Show path and plan, states of shape (n, 6), and the floor around a position, (2,)."""
        self._path.draw()
        if np.max(np.abs(position - self._floor.position[:2])) > _FLOOR_MARGIN * self.cell:
            coarse = 2.0 * self.cell
            self._floor.position = np.append(coarse * np.round(position / coarse), 0.0)
        if plan is not self._drawn_plan:
            self._drawn_plan = plan
            self._show_plan(plan)

    def _show_plan(self, plan: Vector) -> None:
        height = np.full((len(plan), 1), 1.5 * _ON_FLOOR * self.size)
        # A curve needs distinct points, which a plan at its goal does not have.
        points = without_repeats(np.hstack((plan[:, POSITION], height)), self.size / 150.0)
        drawable = len(points) >= 2
        if drawable:
            self._plan.points = points.astype(np.float32)
            self._knots.points = points[1:].astype(np.float32)
        self._plan.visible = self._knots.visible = drawable
