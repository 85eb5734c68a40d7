# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The viewer without a browser: where it listens, what it does with requests."""

import itertools
import socket
import urllib.request
from collections.abc import Iterator, Sequence
from urllib.parse import urlsplit

import numpy as np
import pytest

pytest.importorskip("viser")

from sphere_nmpc.model.state import make_state, state_error
from sphere_sim.viewer.frame import Frame, Offers, Pause, Request, SetGoal
from sphere_sim.viewer.gate import HOST
from sphere_sim.viewer.presets import PRESETS
from sphere_sim.viewer.trail import Trail
from sphere_sim.viewer.viewer import Viewer

UPRIGHT = (1.0, 0.0, 0.0, 0.0)


class Script:
    """A source that plays given frames and notes requests."""

    def __init__(self) -> None:
        self.next: list[Frame] = [Frame()]
        self.requests: list[Request] = []

    def frames(self) -> Sequence[Frame]:
        return self.next

    def handle(self, request: Request) -> str:
        self.requests.append(request)
        return ""


@pytest.fixture
def script() -> Script:
    return Script()


@pytest.fixture
def viewer(script) -> Iterator[Viewer]:
    viewer = Viewer(script, 0, live=True)
    yield viewer
    viewer.close()


def at(x: float, y: float, **more) -> Frame:
    return Frame(state=make_state((x, y), UPRIGHT), offers=Offers(goal=True, pause=True), **more)


def test_the_page_is_served_to_this_machine_only(viewer) -> None:
    assert viewer.url.startswith(f"http://{HOST}:")
    with urllib.request.urlopen(viewer.url, timeout=10.0) as page:
        assert page.status == 200
    port = urlsplit(viewer.url).port
    with socket.socket() as other:
        # The whole of 127.0.0.0/8 is this machine; a listener on every address would answer.
        other.settimeout(2.0)
        assert other.connect_ex(("127.0.0.2", port)) != 0


def test_no_tunnel_to_the_outside_can_be_asked_for(viewer) -> None:
    assert viewer._server.request_share_url() is None


def test_nothing_known_is_shown_without_error(viewer) -> None:
    viewer.tick()
    viewer.tick()


def test_a_drag_sends_its_goal_when_let_go_of(viewer, script) -> None:
    script.next = [at(1.0, 2.0)]
    viewer.tick()
    gizmo = viewer._goal
    viewer._controls.put("start")
    viewer.tick()
    gizmo._place.position = (0.5, -0.5, 0.3)
    script.next = [at(1.0, 2.0, goal=make_state((3.0, 3.0), UPRIGHT))]
    viewer.tick()
    assert gizmo.goal[:2].tolist() == [0.5, -0.5], "nobody moves what a user has in hand"
    viewer._controls.put("end")
    viewer.tick()
    (request,) = script.requests
    assert isinstance(request, SetGoal) and request.goal[:2].tolist() == [0.5, -0.5]


def test_the_ghost_follows_a_goal_of_somebody_else(viewer, script) -> None:
    goal = make_state((1.0, -1.0), (0.5, 0.5, 0.5, 0.5))
    script.next = [at(0.0, 0.0, goal=goal)]
    viewer.tick()
    assert state_error(viewer._goal.goal, goal) < 1e-9


def test_a_preset_is_sent_at_once_or_with_the_button(viewer, script) -> None:
    script.next = [at(1.0, 2.0)]
    viewer.tick()
    name = "upside down, here"
    viewer._controls.put(name)
    viewer.tick()
    expected = PRESETS[name](script.next[0].state)
    assert state_error(script.requests[-1].goal, expected) < 1e-9
    viewer._controls._at_once.value = False
    viewer._controls.put("origin, upright")
    viewer.tick()
    assert len(script.requests) == 1
    viewer._controls.put("send")
    viewer.tick()
    assert script.requests[-1].goal[:2].tolist() == [0.0, 0.0]


def test_other_requests_are_passed_on(viewer, script) -> None:
    viewer._controls.put(Pause(True))
    viewer.tick()
    assert script.requests == [Pause(True)]


def test_a_sphere_of_another_size_is_made_anew(viewer, script) -> None:
    for radius in (0.3, 0.5):
        script.next = [at(0.0, 0.0, radius=radius)]
        viewer.tick()
    assert viewer._scene._ball.radius == 0.5


def test_plans_that_stand_still_are_not_drawn(viewer, script) -> None:
    still = np.tile(make_state((1.0, 1.0), UPRIGHT), (5, 1))
    moving = still + np.linspace(0.0, 1.0, 5)[:, None] * np.eye(6)[0]
    for plan, there in ((still, False), (moving, True), (np.empty((0, 6)), False)):
        script.next = [at(1.0, 1.0, plan=plan)]
        viewer.tick()
        assert viewer._scene._plan.visible is there


def test_a_trail_is_sent_in_pieces_that_join_and_is_of_limited_length(viewer) -> None:
    trail = Trail(viewer._server.scene, "/test", (0, 0, 0), 0.01, 0.01, pieces=3)
    for x in np.arange(0.0, 3.0, 0.02):
        trail.add(np.array([x, 0.0, 0.0]))
        trail.draw()
    pieces = [handle.points for handle in trail._handles]
    assert len(pieces) == 3
    for earlier, later in itertools.pairwise(pieces):
        assert np.array_equal(earlier[-1, 1], later[0, 0])
    trail.clear()
    assert not trail._handles and trail.last is None
