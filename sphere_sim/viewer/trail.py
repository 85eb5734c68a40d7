# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A line that grows point by point, sent in pieces so that what is done is not sent again."""

from collections import deque

import numpy as np
import viser

from sphere_nmpc.model.state import Vector
from sphere_sim.viewer.colours import Colour, as_light
from sphere_sim.viewer.geometry import segments

_PIECE = 40
"""Points of a piece; only the last piece is sent with each frame."""


class Trail:
    """A line of limited length.

    Parameters
    ----------
    scene : viser.SceneApi
        Where it is drawn.
    name : str
        Of its nodes; a parent's pose applies.
    colour : tuple of int
        Red, green, blue.
    thickness : float
        [m].
    spacing : float
        Points nearer than this to the last one are left out [m].
    pieces : int, optional
        Most pieces; the oldest one goes.
    """

    def __init__(
        self, scene: viser.SceneApi, name: str, colour: Colour, thickness: float, spacing: float,
        pieces: int = 40,
    ) -> None:
        self._scene = scene
        self._name = name
        self._colour = as_light(colour)
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
        """The newest point."""
        return self._points[-1] if self._points else None

    def add(self, point: Vector) -> None:
        """Let the line go on to a point, shape (3,)."""
        last = self.last
        if last is not None and float(np.linalg.norm(point - last)) < self._spacing:
            return
        self._points.append(np.array(point, dtype=float))
        self._changed = True
        if len(self._points) > _PIECE:
            self.draw()
            # The next piece begins where this one ends.
            self._points, self._begun = [self._points[-1]], False

    def draw(self) -> None:
        """Send what is new."""
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
        """Wipe the line away."""
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
