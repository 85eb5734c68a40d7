# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Viewer: shows the frames of a source and passes the requests of its page on."""

import math
import time
from dataclasses import replace

import numpy as np

from sphere_nmpc.model.state import POSITION, Vector, make_state
from sphere_sim.viewer.control_panel import ControlPanel
from sphere_sim.viewer.goal import GOAL_PRESETS, GoalGizmo
from sphere_sim.viewer.plots import History, Plots
from sphere_sim.viewer.scene import Scene
from sphere_sim.viewer.server import LocalServer
from sphere_sim.viewer.source import (
    ChooseGoal,
    DragGoal,
    FindSphere,
    Frame,
    PageRequest,
    Request,
    SetGoal,
    SetPath,
    SetPoint,
    Source,
)

FRAME_PERIOD = 0.04
"""Time between two frames [s]."""
_PANEL_PERIOD = 0.2
"""Time between two updates of plots and panel [s]."""


class Viewer:
    """Page that shows the frames of a source, without any part in the control loop.

    Everything happens in `tick`, except the server's callbacks, which only queue requests, and
    collect the places of a path that is drawn.

    The source is `live`, or else a recording; the port is one of this machine.
    """

    def __init__(self, source: Source, port: int, live: bool) -> None:
        self._source = source
        self._server = LocalServer(port)
        self.url = self._server.url
        """Address of the page, with its access token."""
        self._history = History()
        self._scene = Scene(self._server)
        self._panel = ControlPanel(self._server, live)
        self._plots = Plots(self._server)
        self._live = live
        self._goal: GoalGizmo | None = None
        self._frame = Frame()
        self._panel_updated = 0.0
        self._takes_clicks = self._takes_drags = False
        self._drawn: list[tuple[float, float]] = []
        """Places of the path that is being drawn [m]."""

    @property
    def has_pages(self) -> bool:
        """Whether the page is open anywhere."""
        return bool(self._server.get_clients())

    def tick(self) -> None:
        """Handle requests and show new frames; to be called once a `FRAME_PERIOD`."""
        for request in self._panel.take():
            self._carry_out(request)
        if self._panel.clickable.value != self._takes_clicks:
            self._takes_clicks = not self._takes_clicks
            self._scene.report_clicks(self._send_point if self._takes_clicks else None)
        if self._panel.drawable.value != self._takes_drags:
            self._takes_drags = not self._takes_drags
            self._scene.report_drags(self._draw if self._takes_drags else None)
        frames = self._source.frames()
        for frame in frames:
            self._scene.extend_lines(frame)
            self._history.add(frame)
            for notice in frame.notices:
                self._notify(notice)
        self._frame = frames[-1]
        with self._server.atomic():
            path = np.array(self._drawn) if self._drawn else self._frame.path
            self._scene.show(replace(self._frame, path=path))
            self._show_goal()
        now = time.monotonic()
        if now > self._panel_updated + _PANEL_PERIOD:
            self._panel_updated = now
            self._panel.show(self._frame, self._scene.cell)
            if not self.has_pages:
                self._choose_view()
            else:
                self._plots.show(self._history, self._frame.robot)

    def look_at(self, places: Vector) -> None:
        """Set the initial view of the page to these places, shape (n, 2) [m]."""
        self._scene.look_at(places)

    def close(self) -> None:
        """Close the page."""
        self._server.stop()

    def _choose_view(self) -> None:
        """Let the page that is opened next show sphere and goal of a live robot."""
        state = self._frame.state
        if self._live and state is not None:
            goal = state if self._frame.goal is None else self._frame.goal.pose
            places = np.array([state[POSITION], goal[POSITION]])
            if not all(map(self._scene.shows, places)):
                self._scene.look_at(places)

    def _show_goal(self) -> None:
        frame = self._frame
        if self._goal is None or self._goal.radius != self._scene.radius:
            # The gizmo needs the radius of the sphere. A recording without a goal has none.
            if frame.state is None or (frame.goal is None and not self._live):
                return
            on_drag = self._panel.put if self._live else None
            self._goal = GoalGizmo(self._server.scene, self._scene.radius, on_drag)
        self._goal.show(frame.goal, frame.state)

    def _carry_out(self, request: PageRequest) -> None:
        """Carry out a request of the page, or pass it on to the source."""
        gizmo = self._goal
        if isinstance(request, Request):
            self._notify(self._source.handle(request))
            return
        if isinstance(request, FindSphere):
            self._scene.find(self._state())
            return
        if gizmo is None:
            return
        if isinstance(request, ChooseGoal):
            gizmo.move_to(GOAL_PRESETS[request.preset](self._state()))
            self._panel.reset_preset()
            send = self._panel.at_once.value
        elif isinstance(request, DragGoal):
            gizmo.set_dragged(not request.ended)
            send = request.ended and self._panel.at_once.value
        else:
            gizmo.set_dragged(False)
            send = True
        goal = gizmo.goal
        if send and goal is not None:
            self._notify(self._source.handle(SetGoal(goal)))

    def _send_point(self, place: Vector) -> None:
        self._panel.put(SetPoint((float(place[0]), float(place[1]))))

    def _draw(self, place: Vector | None, phase: str) -> None:
        """Extend the path that is drawn; at its end request it."""
        if phase == "start":
            self._drawn = []
        # Steps of a hand that hesitates lead back and forth.
        least = 0.1 * self._scene.cell
        if place is not None and not (self._drawn and math.dist(place, self._drawn[-1]) < least):
            self._drawn.append((float(place[0]), float(place[1])))
        if phase == "end" and self._drawn:
            self._panel.put(SetPath(tuple(self._drawn)))
            self._drawn = []

    def _state(self) -> Vector:
        """Return the state of the sphere; the origin where it is unknown."""
        state = self._frame.state
        return make_state(np.zeros(2), (1.0, 0.0, 0.0, 0.0)) if state is None else state

    def _notify(self, text: str) -> None:
        for client in self._server.get_clients().values() if text else ():
            client.add_notification("sphere_nmpc", text, auto_close_seconds=6.0)
