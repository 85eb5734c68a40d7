# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Three-dimensional scene: created once, then only poses and new points of lines are sent."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from sphere_nmpc.model.state import POSITION, Vector, contact_points
from sphere_sim.output import colours
from sphere_sim.viewer.ball import Ball, Estimate
from sphere_sim.viewer.geometry import arc
from sphere_sim.viewer.ground import Ground, Trail
from sphere_sim.viewer.source import DEFAULT_RADIUS, Frame
from sphere_sim.viewer.walls import Walls

CAMERA = (4.0, -4.4, 2.7)
LOOK_AT = (0.9, -1.2, 0.0)
"""Initial position of the camera, and the point it looks at, for a sphere of `DEFAULT_RADIUS`;
others are seen from a distance in proportion to their radius [m; world frame]."""
_DISTANCE = float(np.linalg.norm(np.subtract(CAMERA, LOOK_AT))) / DEFAULT_RADIUS
"""Initial distance of the camera from the point it looks at over the radius."""
_FIELD = math.radians(45.0)
"""Vertical field of view."""
_MARGIN = 1.05
"""Distance of the camera over that from which a sphere touches the edge of the scene."""
_PANELS = 0.79
"""Width over height of the scene between the panels of a page of 1400 by 900 pixels."""


def _axes() -> Vector:
    """Return the directions to the right, up and ahead of the initial camera, shape (3, 3)."""
    ahead = np.subtract(LOOK_AT, CAMERA) / (_DISTANCE * DEFAULT_RADIUS)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    return np.stack((right, np.cross(right, ahead), ahead))


_AXES = _axes()


class Scene:
    """Scene with the sphere, its lines, its plan and the floor with its walls."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._scene = server.scene
        server.initial_camera.fov = _FIELD
        _add_lights(self._scene)
        self._ball: Ball | None = None
        self._estimate: Estimate | None = None
        self._trace: Trail | None = None
        self.radius = DEFAULT_RADIUS
        """Radius of the sphere [m]; the default one before the first frame with a state."""
        self._ground = Ground(self._scene, self.radius)
        self._on_drag: Callable[[Vector | None, str], object] | None = None
        self._walls = Walls(self._scene)
        self._look_from_the_start()

    @property
    def cell(self) -> float:
        """Spacing of the grid on the floor [m]."""
        return self._ground.cell

    def extend_lines(self, frame: Frame) -> None:
        """Extend the lines to a frame, which itself need not be shown."""
        if frame.restarted:
            self._ground.path.clear()
            if self._trace is not None:
                self._trace.clear()
        if frame.state is None:
            return
        if abs(self.radius - frame.radius) > 1e-3 * frame.radius:
            self._set_radius(frame.radius)
        if self._ball is None or self._trace is None:
            self._ball = Ball(self._scene, self.radius)
            thin = 0.03 * self.radius
            self._trace = Trail(self._scene, "/sphere/trace", colours.TRACE, thin, thin)
        self._ground.extend_path(frame.state[POSITION])
        touching = contact_points(frame.state, 1.008 * self.radius)
        start = touching if self._trace.last is None else self._trace.last
        for point in arc(start, touching, 0.1 * self.radius):
            self._trace.add(point)

    def show(self, frame: Frame) -> None:
        """Show a frame, after `extend_lines` with it."""
        self._walls.show(frame.floor, self.radius)
        if frame.state is not None and self._ball is not None and self._trace is not None:
            self._ground.show(frame.state[POSITION], frame.plan, frame.path)
            self._ball.place(frame.state, frame.rotor_speeds, frame.time)
            self._trace.draw()
            if self._estimate is None and frame.estimate is not None:
                self._estimate = Estimate(self._scene, self.radius)
            if self._estimate is not None:
                self._estimate.place(frame.estimate)

    def shows(self, position: Vector) -> bool:
        """Return whether a new page shows a sphere at a position, shape (2,) [m], as a whole."""
        at, distance = self._view
        return bool(distance_to_show(position[None], at, self.radius) <= distance)

    def report_clicks(self, on_click: Callable[[Vector], object] | None) -> None:
        """Call a function with each position on the floor that is clicked, shape (2,) [m].

        It is called on another thread. Drags, which turn the view, are no clicks. None ends this.
        """
        self._scene.remove_click_callback()
        if on_click is None:
            return

        def report(event: viser.SceneClickEvent) -> None:
            place = on_floor(np.array(event.ray_origin), np.array(event.ray_direction))
            if place is not None and self._ground.covers(place):
                on_click(place)

        self._scene.on_click()(report)

    def report_drags(self, on_drag: Callable[[Vector | None, str], object] | None) -> None:
        """Call a function with the phases of each drag on the floor: start, update, end.

        And with the place, shape (2,) [m], None beside the floor. Otherwise as `report_clicks`,
        but a drag on the floor does not turn the view meanwhile.
        """
        self._on_drag = on_drag
        self._ground.plane.remove_drag_callback()
        if on_drag is None:
            return

        async def report(event: viser.SceneNodeDragEvent[Any]) -> None:
            camera = np.array(event.client.camera.position)
            place = on_floor(camera, np.array(event.end_position) - camera)
            is_there = place is not None and self._ground.covers(place)
            on_drag(place if is_there else None, event.phase)

        self._ground.plane.on_drag(report)

    def look_at(self, places: Vector) -> None:
        """Set the initial view of pages opened from now on to these places, shape (n, 2) [m].

        Where the sphere is small in that view, floor and lines are of the size of the view.
        """
        middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
        needed = _MARGIN * distance_to_show(places, middle, self.radius)
        distance = max(0.5 * _DISTANCE * self.radius, needed)
        self._view = middle, distance
        self._look(*self._view, self._server.initial_camera)
        self._set_ground(max(self.radius, distance / _DISTANCE))

    def find(self, state: Vector) -> None:
        """Point the camera of all pages at the sphere."""
        for client in self._server.get_clients().values():
            self._look(state[POSITION], 0.5 * _DISTANCE * self.radius, client.camera)

    def _set_radius(self, radius: float) -> None:
        """Remove the sphere, set the radius, and look at the origin from the distance it needs."""
        self.radius = radius
        if self._trace is not None:
            self._trace.clear()
        self._ball = self._trace = self._estimate = None
        self._set_ground(radius)
        self._look_from_the_start()

    def _look_from_the_start(self) -> None:
        pages = (client.camera for client in self._server.get_clients().values())
        middle = np.array(LOOK_AT[:2]) * self.radius / DEFAULT_RADIUS
        self._view = middle, _DISTANCE * self.radius
        for camera in (self._server.initial_camera, *pages):
            self._look(*self._view, camera)

    def _set_ground(self, size: float) -> None:
        if size != self._ground.size:
            self._ground.path.clear()
            self._ground = Ground(self._scene, size)
            self.report_drags(self._on_drag)

    def _look(self, at: Vector, distance: float, camera: Any) -> None:
        """Point a camera at a place, shape (2,) [m], from a distance [m]."""
        place = np.array((at[0], at[1], 0.0))
        camera.position = place - distance * _AXES[2]
        camera.look_at = place


def distance_to_show(places: Vector, at: Vector, radius: float) -> float:
    """Return how far the camera has to be from the point on the floor that it looks at [m].

    From there it shows spheres of a radius [m] at `places`, shape (n, 2), between the panels; the
    point is at `at`, shape (2,) [m].
    """
    offsets = np.column_stack((places - at, np.full(len(places), radius)))
    right, up, ahead = _AXES @ offsets.T
    half = math.tan(0.5 * _FIELD)
    needed = np.maximum((np.abs(right) + radius) / (half * _PANELS), (np.abs(up) + radius) / half)
    return float(np.max(needed - ahead))


def on_floor(origin: Vector, direction: Vector) -> Vector | None:
    """Return where a ray, shapes (3,), meets the floor from above, shape (2,) [m]; None if not."""
    if not (origin[2] > 0.0 > direction[2]):
        return None
    place: Vector = (origin - origin[2] / direction[2] * direction)[:2]
    return place if np.all(np.isfinite(place)) else None


def _add_lights(scene: viser.SceneApi) -> None:
    """Add uniform light from above, and directional light that makes shapes visible.

    The lights cast no shadows: without a graphics card, these would take more processor time than
    all the rest of the scene.
    """
    scene.configure_default_lights(enabled=False)
    scene.add_light_hemisphere(
        "/light/sky", sky_color=(255, 255, 255), ground_color=(190, 195, 200), intensity=2.0
    )
    scene.add_light_directional(
        "/light/lamp", intensity=1.8, position=(2.0, -3.0, 5.0), cast_shadow=False
    )
