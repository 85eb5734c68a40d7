# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goal on the page: a translucent sphere that users move by gizmos, or to one of a list."""

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, make_state, state_error
from sphere_sim.output import colours
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.viewer.ball import add_shell
from sphere_sim.viewer.source import DragGoal

_VISIBLE = 1e-4
"""Least error from the goal in force that the label shows [mixed units]."""
_ORIGIN = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
_ON_GAMMA = math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0
_DRAG_TIMEOUT = 10.0
"""Time after which a drag without events is over, as when its page is closed [s]."""


def _fixed(goal: Vector) -> Callable[[Vector], Vector]:
    return lambda state: goal


def _turned(*wxyz: float) -> Callable[[Vector], Vector]:
    """Return the rotation of a state at its place, in the world frame."""
    return lambda state: make_state(
        state[POSITION], rotation.product(np.array(wxyz), state[QUATERNION])
    )


GOAL_PRESETS: dict[str, Callable[[Vector], Vector]] = {
    "origin, upright": _fixed(_ORIGIN),
    **{f"goal of the paper's case {i}": _fixed(case.goal) for i, case in PAPER_CASES.items()},
    **{f"start of the paper's case {i}": _fixed(case.start) for i, case in PAPER_CASES.items()},
    "half turn about the vertical, here": _turned(0.0, 0.0, 0.0, 1.0),
    "upside down, here": _turned(0.0, 1.0, 0.0, 0.0),
    "upright, here": lambda state: make_state(state[POSITION], _ORIGIN[QUATERNION]),
    "on circle Γ, here": lambda state: make_state(state[POSITION], _ON_GAMMA),
    "1 m ahead in x": lambda state: state + np.eye(6)[0],
}
"""Goal of each name, shape (6,), as a function of the present state, shape (6,)."""


class GoalGizmo:
    """Translucent sphere with two gizmos: arrows and a square in the plane, and three rings.

    There are two because the arrows keep their directions while the rings turn with the sphere.
    `on_drag` is called, on another thread, with each step of a drag; without it users cannot move
    the goal.
    """

    def __init__(
        self, scene: viser.SceneApi, radius: float, on_drag: Callable[[DragGoal], object] | None
    ) -> None:
        self.radius = radius
        """Radius of the shell [m]."""
        self._position, self._orientation = self._add_handles(scene, on_drag)
        self._shell = add_shell(scene, "/goal/turn/shell", 0.98 * radius, colours.GOAL, 0.45)
        self._plain = scene.add_icosphere(
            "/goal/plain", 0.98 * radius, colours.GOAL, opacity=0.3, visible=False,
            cast_shadow=False, receive_shadow=False,
        )
        self._label = scene.add_label(
            "/goal/label", "goal", position=(0.0, 0.0, -1.4 * radius), anchor="top-center"
        )
        self._in_force: Goal | None = None
        self._dragged_until = 0.0

    def _add_handles(
        self, scene: viser.SceneApi, on_drag: Callable[[DragGoal], object] | None
    ) -> tuple[Any, Any]:
        position = (0.0, 0.0, self.radius)
        if on_drag is None:
            frame = scene.add_frame("/goal", show_axes=False, position=position)
            return frame, scene.add_frame("/goal/turn", show_axes=False)
        handles = (
            scene.add_transform_controls(
                "/goal", scale=2.1 * self.radius, active_axes=(True, True, False),
                disable_rotations=True, depth_test=False, position=position, line_width=3.5,
            ),
            scene.add_transform_controls(
                "/goal/turn", scale=1.7 * self.radius, disable_axes=True, disable_sliders=True,
                depth_test=False, line_width=3.0, opacity=0.8,
            ),
        )

        async def report(event: viser.TransformControlsEvent) -> None:
            on_drag(DragGoal(ended=event.phase == "end"))

        for handle in handles:
            handle.on_update(report)
        return handles

    @property
    def goal(self) -> Vector | None:
        """Pose of the gizmo, shape (6,); None if a page has sent an invalid one."""
        try:
            return make_state(self._position.position[:2], self._orientation.wxyz)
        except InvalidStateError:
            return None

    def set_dragged(self, dragged: bool) -> None:
        """Set whether a user drags the gizmo; it does not follow the goal in force meanwhile."""
        self._dragged_until = time.monotonic() + _DRAG_TIMEOUT if dragged else 0.0

    def move_to(self, goal: Vector) -> None:
        """Move the gizmo to a goal, shape (6,)."""
        self._position.position = (float(goal[0]), float(goal[1]), self.radius)
        self._orientation.wxyz = goal[QUATERNION]

    def show(self, in_force: Goal | None, state: Vector | None) -> None:
        """Follow the goal in force when it changes, and update shell and label.

        Of a goal that leaves something of the orientation free the shell shows what is nearest to
        the sphere's `state`, shape (6,), and nothing where all is free.
        """
        known = self._in_force
        if in_force is None:
            self._in_force = None
        elif time.monotonic() > self._dragged_until and not (known and in_force.equals(known)):
            self._in_force = in_force
            self.move_to(in_force.pose)
        known, goal = self._in_force, self.goal
        if goal is None:
            goal = _ORIGIN if known is None else known.pose
            self.move_to(goal)
        equal = known is not None and state_error(goal, known.pose) < _VISIBLE
        orientation = known.orientation if known is not None and equal else Orientation.FULL
        nearest = goal if state is None else orientation.nearest(goal, state)
        turn = rotation.product(rotation.conjugate(goal[QUATERNION]), nearest[QUATERNION])
        self._plain.visible = orientation is Orientation.ANY
        self._shell.visible = not self._plain.visible
        if self._shell.visible:
            self._shell.wxyz = turn
        remark = orientation.remark if equal else "not in force"
        text = f"goal, {remark}" if remark else "goal"
        if text != self._label.text:
            self._label.text = text
