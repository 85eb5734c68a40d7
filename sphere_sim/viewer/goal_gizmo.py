# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The goal as a ghost of the sphere that is dragged over the floor and turned by rings."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.model.state import QUATERNION, Vector, make_state, state_error
from sphere_sim.viewer import colours
from sphere_sim.viewer.ball import add_shell

_SAME = 1e-6
"""Largest error of a goal that counts as the one in force [mixed units]."""
_SEEN = 1e-4
"""Least error that is worth telling [mixed units]."""
_ORIGIN = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
_LOST = 10.0
"""Time after which a drag that neither goes on nor ends is given up, as when a page closes [s]."""


class GoalGizmo:
    """A ghost with two gizmos: arrows and a square in the plane, and three rings.

    Two, because the arrows have to stay in the floor while the rings turn with the ghost.

    Parameters
    ----------
    scene : viser.SceneApi
        The scene.
    radius : float
        Of the shell [m].
    moved : callable or None
        Called, on another thread, with the phase of a drag: start, update or end; None if the
        ghost cannot be moved by hand.
    """

    def __init__(
        self, scene: viser.SceneApi, radius: float, moved: Callable[[str], object] | None
    ) -> None:
        self._radius = radius
        self._place, self._turn = self._add_handles(scene, moved)
        add_shell(scene, "/goal/turn/shell", 0.98 * radius, colours.GOAL, 0.45)
        self._label = scene.add_label(
            "/goal/label", "goal", position=(0.0, 0.0, -1.4 * radius), anchor="top-center"
        )
        self._in_force: Vector | None = None
        self._held_until = 0.0

    def _add_handles(
        self, scene: viser.SceneApi, moved: Callable[[str], object] | None
    ) -> tuple[Any, Any]:
        position = (0.0, 0.0, self._radius)
        if moved is None:
            place = scene.add_frame("/goal", show_axes=False, position=position)
            return place, scene.add_frame("/goal/turn", show_axes=False)
        handles = (
            scene.add_transform_controls(
                "/goal", scale=2.1 * self._radius, active_axes=(True, True, False),
                disable_rotations=True, depth_test=False, position=position, line_width=3.5,
            ),
            scene.add_transform_controls(
                "/goal/turn", scale=1.7 * self._radius, disable_axes=True, disable_sliders=True,
                depth_test=False, line_width=3.0, opacity=0.8,
            ),
        )

        async def pass_on(event: viser.TransformControlsEvent) -> None:
            moved(event.phase)

        for handle in handles:
            handle.on_update(pass_on)
        return handles

    @property
    def goal(self) -> Vector | None:
        """Where the ghost is, shape (6,); None where a page has put it nowhere."""
        wxyz = np.array(self._turn.wxyz, dtype=float)
        try:
            with np.errstate(all="ignore"):
                return make_state(self._place.position[:2], wxyz / np.linalg.norm(wxyz))
        except InvalidStateError:
            return None

    def hold(self, held: bool) -> None:
        """Say whether a user has the ghost in hand; nothing else moves it meanwhile."""
        self._held_until = time.monotonic() + _LOST if held else 0.0

    def put(self, goal: Vector) -> None:
        """Move the ghost to a goal, shape (6,)."""
        self._place.position = (float(goal[0]), float(goal[1]), self._radius)
        self._turn.wxyz = goal[QUATERNION]

    def show(self, in_force: Vector | None) -> None:
        """Follow the goal in force when it changes, and label the ghost."""
        if in_force is not None and time.monotonic() > self._held_until:
            known = self._in_force
            if known is None or state_error(in_force, known) > _SAME:
                self._in_force = in_force
                self.put(in_force)
        if self.goal is None:
            self.put(_ORIGIN if self._in_force is None else self._in_force)
        goal = self.goal
        if self._in_force is None or goal is None:
            text = "goal, not sent"
        else:
            agreed = state_error(goal, self._in_force) < _SEEN
            text = "goal" if agreed else "goal, not in force"
        if text != self._label.text:
            self._label.text = text
