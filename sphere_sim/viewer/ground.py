# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What lies on the ground of the scene: floor, world axes, paths and plan; and growing lines."""

from collections import deque

import numpy as np
import viser

from sphere_nmpc.model.state import POSITION, Vector
from sphere_sim.output import colours
from sphere_sim.output.colours import Colour, linear
from sphere_sim.output.round_numbers import grid_cell
from sphere_sim.viewer.geometry import segments, without_repeats

_CELLS = 12
"""Cells of the grid from the middle of the floor to its edge."""
_FLOOR_MARGIN = 7
"""Cells between sphere and middle of the floor from which on the floor follows."""
_PLAIN: Colour = (240, 242, 244)
_FINE: Colour = (218, 223, 228)
_COARSE: Colour = (184, 192, 200)
_ON_FLOOR = 4.0 / 300.0
"""Height of lines on the floor over the size."""
_PIECE = 40
"""Points of a piece of a growing line; with each frame only the last piece is sent."""
_PIECES = 40
"""Most pieces of a growing line; beyond it the oldest piece is removed."""


class Ground:
    """Floor, world axes, path and plan, in place of those of an earlier ground.

    The size is the radius of a sphere beside which lines and grid look right [m].
    """

    def __init__(self, scene: viser.SceneApi, size: float) -> None:
        self.size = size
        self.cell = grid_cell(size)
        """Spacing of the grid [m]."""
        self._floor, self.plane = _add_floor(scene, self.cell)
        """Frame of the floor, and its surface."""
        scene.add_frame(
            "/world", axes_length=0.25 / 0.3 * size, axes_radius=0.008 / 0.3 * size,
            origin_radius=0.04 * size, position=(0.0, 0.0, _ON_FLOOR * size),
        )
        self.path = Trail(scene, "/path", colours.PATH, 0.04 * size, size / 30.0)
        self._plan = scene.add_spline_catmull_rom(
            "/plan/line", np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]), color=colours.PLAN,
            thickness=size / 15.0, visible=False,
        )
        self._knots = scene.add_point_cloud(
            "/plan/knots", np.zeros((1, 3)), colours.PLAN, point_size=0.035 / 0.3 * size,
            point_shape="circle", precision="float32", visible=False,
        )
        self._drawn_plan: Vector | None = None
        self._followed = scene.add_line_segments(
            "/followed", np.zeros((1, 2, 3)), linear(colours.GOAL), thickness=size / 15.0,
            visible=False,
        )
        self._drawn_path: Vector | None = None

    def covers(self, position: Vector) -> bool:
        """Return whether a position, shape (2,) [m], is on the floor that is drawn."""
        return bool(np.all(np.abs(position - self._floor.position[:2]) <= _CELLS * self.cell))

    def extend_path(self, position: Vector) -> None:
        """Extend the path to a position, shape (2,) [m]."""
        self.path.add(np.array([*position, _ON_FLOOR * self.size]))

    def show(self, position: Vector, plan: Vector, followed: Vector) -> None:
        """Show path, plan, path to follow, and the floor around a position, shape (2,).

        The plan is of states, (n, 6), the path to follow of places, (n, 2).
        """
        self.path.draw()
        if followed is not self._drawn_path:
            self._drawn_path = followed
            self._followed.visible = len(followed) >= 2
            if self._followed.visible:
                height = np.full((len(followed), 1), 1.2 * _ON_FLOOR * self.size)
                self._followed.points = segments(np.hstack((followed, height)))
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


class Trail:
    """Line that grows point by point, of limited length, sent to pages in pieces.

    It is a node of the scene, with a thickness and a least distance between two points [m].
    """

    def __init__(
        self, scene: viser.SceneApi, name: str, colour: Colour, thickness: float, spacing: float
    ) -> None:
        self._scene, self._name = scene, name
        self._colour = np.array(linear(colour), dtype=np.uint8)
        self._thickness, self._spacing = thickness, spacing
        self._handles: deque[viser.LineSegmentsHandle] = deque()
        self._points: list[Vector] = []
        self._made = 0
        self._changed = False
        self._begun = False
        """Whether the page has the piece that grows."""

    @property
    def last(self) -> Vector | None:
        """Newest point; None without any."""
        return self._points[-1] if self._points else None

    def add(self, point: Vector) -> None:
        """Extend the line to a point, shape (3,) [m]."""
        last = self.last
        if last is not None and float(np.linalg.norm(point - last)) < self._spacing:
            return
        self._points.append(np.array(point, dtype=float))
        self._changed = True
        if len(self._points) > _PIECE:
            self.draw()
            # The next piece begins at the end of this one.
            self._points, self._begun = [self._points[-1]], False

    def draw(self) -> None:
        """Send the points since the last call."""
        if not self._changed or len(self._points) < 2:
            return
        self._changed = False
        pieces = segments(np.array(self._points))
        colours_ = np.broadcast_to(self._colour, (len(pieces), 2, 3)).copy()
        if self._begun:
            self._handles[-1].points, self._handles[-1].colors = pieces, colours_
            return
        self._begun, self._made = True, self._made + 1
        self._handles.append(self._scene.add_line_segments(
            f"{self._name}/{self._made}", pieces, colours_, thickness=self._thickness,
        ))
        if len(self._handles) > _PIECES:
            self._handles.popleft().remove()

    def clear(self) -> None:
        """Delete the line."""
        while self._handles:
            self._handles.popleft().remove()
        self._points, self._changed, self._begun = [], False, False


def _add_floor(
    scene: viser.SceneApi, cell: float
) -> tuple[viser.FrameHandle, viser.MeshHandle]:
    """Add the floor, a line every `cell` [m] and every other one stronger.

    Return its frame, and its plane.
    """
    frame = scene.add_frame("/floor", show_axes=False)
    half = _CELLS * cell
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    surface = scene.add_mesh_simple(
        "/floor/plane", corners, faces, color=_PLAIN, cast_shadow=False,
        position=(0.0, 0.0, -0.004 * cell), receive_shadow=False,
    )
    places = cell * np.arange(-_CELLS, _CELLS + 1, dtype=np.float64)
    for name, chosen, colour, width in (
        ("fine", places[1::2], _FINE, 1.0), ("coarse", places[::2], _COARSE, 1.5)
    ):
        scene.add_line_segments(
            f"/floor/{name}", _lines(chosen, half), linear(colour), thickness=width,
            thickness_units="screen",
        )
    return frame, surface


def _lines(places: Vector, half: float) -> Vector:
    """Return lines along x and y at these n coordinates [m], shape (2 n, 2, 3)."""
    n = len(places)
    lines = np.zeros((2 * n, 2, 3))
    lines[:n, :, 0], lines[n:, :, 1] = (-half, half), (-half, half)
    lines[:n, :, 1], lines[n:, :, 0] = places[:, None], places[:, None]
    return lines
