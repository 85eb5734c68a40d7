# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The viewer: takes frames from a source and requests from the page, and owns no control loop."""

import time

import numpy as np

from sphere_nmpc.model.state import POSITION, Vector, make_state
from sphere_sim.viewer.controls import Controls
from sphere_sim.viewer.frame import Frame, Request, SetGoal, Source
from sphere_sim.viewer.goal_gizmo import GoalGizmo
from sphere_sim.viewer.history import History
from sphere_sim.viewer.plots import Plots
from sphere_sim.viewer.presets import PRESETS
from sphere_sim.viewer.scene import LOOK_AT, Scene
from sphere_sim.viewer.server import LocalServer

FRAME_PERIOD = 0.04
"""Time between two frames [s]; what happens in between is not shown."""
_WORDS_PERIOD = 0.2
"""Time between two updates of plots and words [s]."""
_NEAR = 4.0
"""How far from where the page looks at first the sphere may be for that to be left so [m]."""


class Viewer:
    """A page, the frames it shows, and the requests that come from it.

    Everything but the server's callbacks, which only queue requests, happens in `tick`.

    Parameters
    ----------
    source : Source
        Where frames come from and where requests go.
    port : int
        Where to listen on this machine.
    live : bool
        Whether the source is live; else it is a recording.
    """

    def __init__(self, source: Source, port: int, live: bool) -> None:
        self._source = source
        self._server = LocalServer(port)
        self._history = History()
        self._scene = Scene(self._server)
        self._controls = Controls(self._server, live)
        self._plots = Plots(self._server)
        self._live = live
        self._goal: GoalGizmo | None = None
        self._frame = Frame()
        self._worded = 0.0
        self._seen = False

    @property
    def url(self) -> str:
        """Address of the page, with the token that lets in."""
        return self._server.url

    def tick(self) -> None:
        """Take up requests and show what is new; to be called once a `FRAME_PERIOD`."""
        for request in self._controls.take():
            self._take_up(request)
        frames = self._source.frames()
        for frame in frames:
            self._scene.follow(frame)
            self._history.add(frame)
            for news in frame.news:
                self._tell(news)
        self._frame = frames[-1]
        state = self._frame.state
        if not self._seen and self._live and state is not None:
            # Who runs far from the origin is seen all the same.
            self._seen = True
            if np.linalg.norm(state[POSITION] - LOOK_AT[:2]) > _NEAR:
                self._scene.look_at(state[None, POSITION])
        with self._server.atomic():
            self._scene.show(self._frame)
            self._show_goal()
        now = time.monotonic()
        if now > self._worded + _WORDS_PERIOD:
            self._worded = now
            self._controls.show(self._frame)
            if self._server.get_clients():
                self._plots.show(self._history)

    def look_at(self, places: Vector) -> None:
        """Let the page begin with a view of these places, shape (n, 2) [m]."""
        self._scene.look_at(places)

    def close(self) -> None:
        """Close the page."""
        self._server.stop()

    def _show_goal(self) -> None:
        frame = self._frame
        if self._goal is None:
            # A ghost of the right size needs to know the size; nothing is asked of no sphere, nor
            # of one that was recorded without a goal.
            if frame.state is None or (frame.goal is None and not self._live):
                return
            moved = self._controls.put if self._live else None
            self._goal = GoalGizmo(self._server.scene, frame.radius, moved)
        self._goal.show(frame.goal)

    def _take_up(self, request: Request | str) -> None:
        if not isinstance(request, str):
            self._tell(self._source.handle(request))
            return
        if request == "find":
            self._scene.find(self._where())
        elif self._goal is not None:
            self._steer(request, self._goal)

    def _steer(self, request: str, ghost: GoalGizmo) -> None:
        if request in PRESETS:
            ghost.put(PRESETS[request](self._where()))
            self._controls.picked()
        else:
            ghost.hold(request in ("start", "update"))
        if request == "send" or (
            self._controls.sends_at_once and (request == "end" or request in PRESETS)
        ):
            goal = ghost.goal
            if goal is not None:
                self._tell(self._source.handle(SetGoal(goal)))

    def _where(self) -> Vector:
        state = self._frame.state
        return make_state(np.zeros(2), (1.0, 0.0, 0.0, 0.0)) if state is None else state

    def _tell(self, news: str) -> None:
        for client in self._server.get_clients().values() if news else ():
            client.add_notification("sphere_nmpc", news, auto_close_seconds=6.0)
