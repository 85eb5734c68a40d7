# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Line that grows point by point, sent to pages in pieces of limited length."""

from collections import deque

import numpy as np
import viser

from sphere_nmpc.model.state import Vector
from sphere_sim.viewer.colours import Colour, linear
from sphere_sim.viewer.geometry import segments

_PIECE = 40
"""Points of a piece; with each frame only the last piece is sent."""


class Trail:
    """Growing line of limited length.

    Parameters
    ----------
    scene : viser.SceneApi
        The scene.
    name : str
        Name of its node, which may have a parent that moves it.
    colour : tuple of int
        Red, green, blue.
    thickness : float
        Thickness [m].
    spacing : float
        Least distance between two points [m].
    pieces : int, optional
        Most pieces; beyond it the oldest piece is removed.
    """

    def __init__(
        self, scene: viser.SceneApi, name: str, colour: Colour, thickness: float, spacing: float,
        pieces: int = 40,
    ) -> None:
        self._scene = scene
        self._name = name
        self._colour = linear(colour)
        self._thickness = thickness
        self._spacing = spacing
        self._limit = pieces
        self._handles: deque[viser.LineSegmentsHandle] = deque()
        self._points: list[Vector] = []
        self._made = 0
        self._changed = False
        self._begun = False

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
        pieces = segments(np.array(self._points))
        if not self._begun:
            self._begin(pieces)
        else:
            self._handles[-1].points = pieces
            self._handles[-1].colors = self._colours(len(pieces))
        self._changed = False

    def clear(self) -> None:
        """Delete the line."""
        while self._handles:
            self._handles.popleft().remove()
        self._points, self._changed, self._begun = [], False, False

    def _begin(self, pieces: np.ndarray) -> None:
        self._made += 1
        self._begun = True
        self._handles.append(self._scene.add_line_segments(
            f"{self._name}/{self._made}", pieces, self._colours(len(pieces)),
            thickness=self._thickness,
        ))
        if len(self._handles) > self._limit:
            self._handles.popleft().remove()

    def _colours(self, number: int) -> np.ndarray:
        return np.broadcast_to(np.array(self._colour, dtype=np.uint8), (number, 2, 3)).copy()
