# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The three-dimensional scene: built once, then only poses and growing lines are sent."""

import numpy as np
import viser

from sphere_nmpc.model.state import POSITION, Vector
from sphere_sim.viewer import colours
from sphere_sim.viewer.ball import Ball
from sphere_sim.viewer.floor import add_floor, add_lights
from sphere_sim.viewer.frame import Frame
from sphere_sim.viewer.geometry import apart, arc, contact_point
from sphere_sim.viewer.trail import Trail

CAMERA = (4.0, -4.4, 2.7)
LOOK_AT = (0.9, -1.2, 0.0)
"""Where the camera stands at first, and where it looks [m; world]."""
_ON_FLOOR = 0.004
"""Height of what is drawn on the floor [m]."""


class Scene:
    """Show frames.

    Parameters
    ----------
    server : viser.ViserServer
        Whose scene it is.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._scene = server.scene
        server.initial_camera.position = CAMERA
        server.initial_camera.look_at = LOOK_AT
        server.initial_camera.fov = np.radians(45.0)
        add_lights(self._scene)
        add_floor(self._scene)
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
        self._told = self._scene.add_label(
            "/told", "", anchor="bottom-center", visible=False, font_screen_scale=1.1
        )
        self._ball: Ball | None = None
        self._trace: Trail | None = None
        self._drawn_plan: Vector | None = None

    def follow(self, frame: Frame) -> None:
        """Take in a frame that need not be shown itself: lines go through it."""
        if frame.fresh:
            self._path.clear()
            if self._trace is not None:
                self._trace.clear()
        if frame.state is None:
            return
        if self._ball is None or abs(self._ball.radius - frame.radius) > 1e-3 * frame.radius:
            self._make(frame.radius)
        self._path.add(np.array([*frame.state[POSITION], _ON_FLOOR]))
        trace = self._trace
        if trace is not None:
            touching = contact_point(frame.state, 1.008 * frame.radius)
            start = touching if trace.last is None else trace.last
            for point in arc(start, touching, 0.1 * frame.radius):
                trace.add(point)

    def show(self, frame: Frame) -> None:
        """Show a frame that was followed."""
        if frame.state is not None and self._ball is not None and self._trace is not None:
            self._ball.place(frame.state, frame.rotor_speeds, frame.time)
            self._path.draw()
            self._trace.draw()
            above = (float(frame.state[0]), float(frame.state[1]), 2.3 * frame.radius)
            self._told.position = above
        told = "; ".join(frame.alerts)
        if told != self._told.text:
            self._told.text = told
            self._told.visible = bool(told)
        if frame.plan is not self._drawn_plan:
            self._drawn_plan = frame.plan
            self._show_plan(frame.plan)

    def _make(self, radius: float) -> None:
        if self._trace is not None:
            self._trace.clear()
        self._ball = Ball(self._scene, radius)
        self._trace = Trail(self._scene, "/sphere/trace", colours.TRACE, 0.03 * radius,
                            0.03 * radius)

    def _show_plan(self, plan: Vector) -> None:
        floor = np.full((len(plan), 1), 1.5 * _ON_FLOOR)
        # Of points that coincide, as at the goal, no curve can be made.
        points = apart(np.hstack((plan[:, POSITION], floor)), 2e-3)
        there = len(points) >= 2
        if there:
            self._plan.points = points.astype(np.float32)
            self._knots.points = points[1:].astype(np.float32)
        self._plan.visible = self._knots.visible = there
