# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Three-dimensional scene: created once, then only poses and new points of lines are sent."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import viser

from sphere_nmpc.model.state import POSITION, Vector, contact_points
from sphere_sim.viewer import colours
from sphere_sim.viewer.ball import Ball
from sphere_sim.viewer.floor import add_floor, add_lights
from sphere_sim.viewer.frame import Frame
from sphere_sim.viewer.geometry import arc, without_repeats
from sphere_sim.viewer.trail import Trail

CAMERA = (4.0, -4.4, 2.7)
LOOK_AT = (0.9, -1.2, 0.0)
"""Initial position of the camera, and the point it looks at [m; world frame]."""
_ON_FLOOR = 0.004
"""Height of lines on the floor [m]."""
_FLOOR_MARGIN = 3.5
"""Distance of the sphere from the middle of the floor from which on the floor follows [m]."""
_SPAN = 3.6
"""Length that the initial view shows [m]."""


class Scene:
    """Scene with the sphere, its lines, its plan and the floor.

    Parameters
    ----------
    server : viser.ViserServer
        Server of the page.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._scene = server.scene
        self._look((LOOK_AT[0], LOOK_AT[1]), _SPAN, server.initial_camera)
        server.initial_camera.fov = np.radians(45.0)
        add_lights(self._scene)
        self._server = server
        self._floor = add_floor(self._scene)
        self._scene.add_frame(
            "/world", axes_length=0.25, axes_radius=0.008, origin_radius=0.012,
            position=(0.0, 0.0, _ON_FLOOR),
        )
        self._path = Trail(self._scene, "/path", colours.PATH, 0.012, 0.01)
        self._plan = self._scene.add_spline_catmull_rom(
            "/plan/line", np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]), color=colours.PLAN,
            thickness=0.02, visible=False,
        )
        self._knots = self._scene.add_point_cloud(
            "/plan/knots", np.zeros((1, 3)), colours.PLAN, point_size=0.035,
            point_shape="circle", precision="float32", visible=False,
        )
        self._alerts = self._scene.add_label(
            "/alerts", "", anchor="bottom-center", visible=False, font_screen_scale=1.1
        )
        self._ball: Ball | None = None
        self._trace: Trail | None = None
        self._drawn_plan: Vector | None = None

    def extend_lines(self, frame: Frame) -> None:
        """Extend the lines to a frame, which itself need not be shown."""
        if frame.restarted:
            self._path.clear()
            if self._trace is not None:
                self._trace.clear()
        if frame.state is None:
            return
        if self._ball is None or abs(self._ball.radius - frame.radius) > 1e-3 * frame.radius:
            self._create_ball(frame.radius)
        self._path.add(np.array([*frame.state[POSITION], _ON_FLOOR]))
        trace = self._trace
        if trace is not None:
            touching = contact_points(frame.state, 1.008 * frame.radius)
            start = touching if trace.last is None else trace.last
            for point in arc(start, touching, 0.1 * frame.radius):
                trace.add(point)

    def show(self, frame: Frame) -> None:
        """Show a frame, after `extend_lines` with it."""
        if frame.state is not None and self._ball is not None and self._trace is not None:
            self._move_floor(frame.state[POSITION])
            self._ball.place(frame.state, frame.rotor_speeds, frame.time)
            self._path.draw()
            self._trace.draw()
            above = (float(frame.state[0]), float(frame.state[1]), 2.3 * frame.radius)
            self._alerts.position = above
        alerts = "; ".join(frame.alerts)
        if alerts != self._alerts.text:
            self._alerts.text = alerts
            self._alerts.visible = bool(alerts)
        if frame.plan is not self._drawn_plan:
            self._drawn_plan = frame.plan
            self._show_plan(frame.plan)

    def look_at(self, places: Vector) -> None:
        """Set the initial view of pages opened from now on to these places, shape (n, 2) [m]."""
        low, high = places.min(axis=0), places.max(axis=0)
        span = max(0.5 * _SPAN, 1.2 * float(np.linalg.norm(high - low)))
        self._look(0.5 * (low + high), span, self._server.initial_camera)

    def find(self, state: Vector) -> None:
        """Point the camera of all pages at the sphere."""
        for client in self._server.get_clients().values():
            self._look(state[POSITION], 0.5 * _SPAN, client.camera)

    def _look(self, at: Sequence[float] | Vector, span: float, camera: Any) -> None:
        place = np.array((at[0], at[1], 0.0))
        camera.position = place + span / _SPAN * np.subtract(CAMERA, LOOK_AT)
        camera.look_at = place

    def _move_floor(self, position: Vector) -> None:
        """Move the floor by whole metres when the sphere is near its edge."""
        if np.max(np.abs(position - self._floor.position[:2])) > _FLOOR_MARGIN:
            self._floor.position = np.append(np.round(position), 0.0)

    def _create_ball(self, radius: float) -> None:
        if self._trace is not None:
            self._trace.clear()
        self._ball = Ball(self._scene, radius)
        self._trace = Trail(self._scene, "/sphere/trace", colours.TRACE, 0.03 * radius,
                            0.03 * radius)

    def _show_plan(self, plan: Vector) -> None:
        floor = np.full((len(plan), 1), 1.5 * _ON_FLOOR)
        # A curve needs distinct points, which a plan at its goal does not have.
        points = without_repeats(np.hstack((plan[:, POSITION], floor)), 2e-3)
        drawable = len(points) >= 2
        if drawable:
            self._plan.points = points.astype(np.float32)
            self._knots.points = points[1:].astype(np.float32)
        self._plan.visible = self._knots.visible = drawable
