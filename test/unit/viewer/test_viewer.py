# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Viewer without a browser: address, requests, goal, scene and plots."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("viser")

from pages import Script
from robots import GIANT, PALM

from sphere_nmpc.control.goal_report import GoalReport
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.state import make_state, state_error
from sphere_sim.viewer.geometry import Mesh, merged, octants, sector
from sphere_sim.viewer.goal import GOAL_PRESETS
from sphere_sim.viewer.plots import History
from sphere_sim.viewer.scene import on_floor
from sphere_sim.viewer.source import (
    DEFAULT_RADIUS,
    Capabilities,
    ChooseGoal,
    DragGoal,
    Frame,
    Pause,
    SendGoal,
    SetGoal,
    SetPath,
    SetSpeed,
    SetStrategy,
)
from sphere_sim.viewer.viewer import Viewer
from sphere_sim.viewer.walls import blocks

UPRIGHT = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture
def script() -> Script:
    return Script()


@pytest.fixture
def viewer(script) -> Iterator[Viewer]:
    viewer = Viewer(script, 0, live=True)
    yield viewer
    viewer.close()


def at(x: float, y: float, **more) -> Frame:
    return Frame(state=make_state((x, y), UPRIGHT), capabilities=Capabilities(pause=True), **more)


@pytest.fixture
def show(viewer, script) -> Callable[[Frame], None]:
    def show(frame: Frame) -> None:
        script.next, viewer._panel_updated = [frame], 0.0
        viewer.tick()

    return show


def test_pages_cannot_open_a_tunnel(viewer, monkeypatch) -> None:
    tunnels: list[object] = []
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *how: tunnels.append(how))
    viewer._server.request_share_url()
    assert not tunnels


def test_goal_is_sent_at_the_end_of_a_drag(show, viewer, script) -> None:
    viewer.tick()
    assert viewer._scene._ball is None and viewer._goal is None, "without a state"
    show(at(1.0, 2.0))
    gizmo = viewer._goal
    viewer._panel.put(DragGoal(ended=False))
    viewer.tick()
    gizmo._position.position = (0.5, -0.5, 0.3)
    in_force = make_state((3.0, 3.0), (0.5, 0.5, 0.5, 0.5))
    show(at(1.0, 2.0, goal=Goal(in_force)))
    assert gizmo.goal[:2].tolist() == [0.5, -0.5], "a drag has precedence"
    viewer._panel.put(DragGoal(ended=True))
    viewer.tick()
    (request,) = script.requests
    assert isinstance(request, SetGoal) and request.goal[:2].tolist() == [0.5, -0.5]
    assert state_error(gizmo.goal, in_force) < 1e-9, "then the goal in force is shown"
    assert gizmo._label.text == "goal"
    show(at(1.0, 2.0))
    assert gizmo._label.text == "goal, not in force", "it was cancelled"
    assert state_error(gizmo.goal, in_force) < 1e-9


def test_path_is_sent_when_its_drawing_ends_and_the_one_in_force_is_shown(
    show, viewer, script
) -> None:
    line = viewer._scene._ground._followed
    show(at(0.0, 0.0, path=np.array([[0.0, 0.0], [1.0, 0.0]])))
    assert line.visible and line.points.shape == (1, 2, 3)
    for place, phase in (((1.0, 0.0), "start"), ((1.02, 0.0), ""), (None, ""), ((2.0, 1.0), ""),
                         ((3.0, 1.0), "")):
        viewer._draw(place, phase)
    viewer.tick()
    assert script.requests == [] and line.points.shape == (2, 2, 3)
    viewer._draw(None, "end")
    viewer.tick()
    assert script.requests == [SetPath(((1.0, 0.0), (2.0, 1.0), (3.0, 1.0)))]
    progress = GoalReport("1.0", 0, 1, time_left=4.0, distance_left=2.5, deviation=-0.012)
    show(at(0.0, 0.0, progress=progress))
    assert not line.visible
    assert "<b>2.50 m</b> of path, <b>-12 mm</b> off it<" in viewer._panel._numbers.content


def test_goal_is_drawn_without_what_it_leaves_free(show, viewer) -> None:
    pose = make_state((1.0, 0.0), UPRIGHT)

    def drawn(orientation: Orientation) -> tuple[str, bool, bool]:
        show(replace(frame, goal=Goal(pose, orientation)))
        gizmo = viewer._goal
        return gizmo._label.text, gizmo._shell.visible, gizmo._plain.visible

    turned = make_state((0.0, 0.0), (np.cos(0.4), 0.0, 0.0, np.sin(0.4)))
    frame = Frame(state=turned)
    assert drawn(Orientation.ANY) == ("goal, position only", False, True)
    assert "to the goal: <b>1.000 m</b>, position only<br>" in viewer._panel._numbers.content
    assert drawn(Orientation.ANY_HEADING) == ("goal, any heading", True, False)
    assert viewer._goal._shell.wxyz == pytest.approx(turned[2:]), "with the sphere's heading"
    assert drawn(Orientation.FULL) == ("goal", True, False)
    assert viewer._goal._shell.wxyz == pytest.approx(UPRIGHT)
    drawn(Orientation.ANY)
    viewer._goal._orientation.wxyz = turned[2:]
    assert drawn(Orientation.ANY) == ("goal, not in force", True, False), "it is being turned"


def test_preset_is_sent_at_once_or_with_the_button(show, viewer, script) -> None:
    show(at(1.0, 2.0))
    name = "upside down, here"
    viewer._panel.put(ChooseGoal(name))
    viewer.tick()
    expected = GOAL_PRESETS[name](script.next[0].state)
    assert state_error(script.requests[-1].goal, expected) < 1e-9
    viewer._panel.at_once.value = False
    viewer._panel.put(ChooseGoal("origin, upright"))
    viewer.tick()
    assert len(script.requests) == 1
    viewer._panel.put(SendGoal())
    viewer._panel.put(Pause(True))
    viewer.tick()
    assert script.requests[1].goal[:2].tolist() == [0.0, 0.0]
    assert script.requests[2:] == [Pause(True)]


@pytest.mark.parametrize(
    ("origin", "direction", "place"),
    [((1.0, 2.0, 3.0), (0.0, 0.5, -1.5), (1.0, 3.0)), ((1.0, 2.0, 3.0), (0.0, 1.0, 0.1), None),
     ((1.0, 2.0, -3.0), (0.0, 0.0, 1.0), None), ((1.0, 2.0, 3.0), (1.0, 0.0, np.nan), None),
     ((np.inf, 2.0, 3.0), (1.0, 0.0, -1.0), None)],
)
def test_ray_of_a_click_meets_the_floor_or_nothing(origin, direction, place) -> None:
    found = on_floor(np.array(origin), np.array(direction))
    assert place is None if found is None else found.tolist() == pytest.approx(place)


def test_what_is_left_of_the_way_is_shown(show, viewer) -> None:
    show(at(1.0, 2.0, progress=GoalReport("1.0", 1, 3, time_left=4.25, distance_left=2.5)))
    shown = viewer._panel._numbers.content
    assert "left: <b>4.2 s</b>, <b>2.50 m</b> of path; goal <b>2 of 3</b>" in shown
    lines = shown.count("<br>")
    viewer._panel.show(at(1.0, 2.0), 0.5)
    assert viewer._panel._numbers.content.count("<br>") == lines, "widgets below would move"
    assert "no plan yet<br>to the goal: –<br>left: –<" in viewer._panel._numbers.content


def test_errors_are_shown_in_metres_and_degrees(show, viewer) -> None:
    show(at(1.0, 2.0, goal=Goal(make_state((1.0, 2.0), (0.0, 1.0, 0.0, 0.0)))))
    assert "to the goal: <b>0.000 m</b>, <b>180.00°</b><br>" in viewer._panel._numbers.content
    history = History()
    history.add(viewer._frame)
    assert history.series()["angle"] == pytest.approx([180.0])


def widget(viewer: Viewer, label: str):
    handles = viewer._server.gui._gui_input_handle_from_uuid.values()
    return next(handle for handle in handles if handle.label == label)


def in_force(speed: float, strategy: str) -> Frame:
    offered = Capabilities(speed=speed, strategies=("paper", "time_optimal"))
    return replace(at(1.0, 2.0, strategy=strategy), capabilities=offered)


@pytest.mark.parametrize(
    ("label", "chosen", "invalid", "request_"),
    [("strategy", "paper", "none", SetStrategy("paper")), ("speed", 0.5, np.nan, SetSpeed(0.5)),
     ("goal", "upside down, here", "none", ChooseGoal("upside down, here"))],
)
def test_choice_on_the_page_is_neither_overwritten_nor_lost_nor_repeated(
    viewer, label, chosen, invalid, request_
) -> None:
    panel, before = viewer._panel, in_force(2.0, "time_optimal")
    panel.show(before, 0.5)
    assert panel.take() == [], "what the program shows is no request"
    shown = widget(viewer, label).value
    # As the server does on its own thread when the page sends the value.
    widget(viewer, label)._impl.value = invalid
    assert panel.take() == [] and widget(viewer, label).value == shown
    widget(viewer, label)._impl.value = chosen
    panel.show(replace(before, capabilities=replace(before.capabilities, paused=True)), 0.5)
    assert panel.take() == [request_] and panel.take() == []
    if label != "goal":
        panel.show(before, 0.5)
        assert widget(viewer, label).value == shown, "it was refused"


def test_robots_of_other_sizes_are_shown_as_that_of_the_paper_at_another_scale(
    show, viewer
) -> None:
    def lengths() -> np.ndarray:
        """Return lengths of the view, of what lies on the floor and of the goal [m]."""
        camera, ground = viewer._server.initial_camera, viewer._scene._ground
        goal = viewer._goal._position
        return np.array([
            *camera.position, *camera.look_at, ground._plan.thickness, ground.path._spacing,
            viewer._scene._trace._thickness, goal.scale, goal.position[2],
        ])

    show(at(0.0, 0.0))
    before = lengths()
    for radius, grid in ((PALM.shell_radius, "every 0.05 m"), (GIANT.shell_radius, "every 1 m")):
        show(at(0.0, 0.0, radius=radius))
        np.testing.assert_allclose(lengths(), before * radius / DEFAULT_RADIUS)
        assert viewer._scene._ball.radius == radius
        assert grid in viewer._panel._legend.content


@pytest.mark.parametrize("radius", [DEFAULT_RADIUS, PALM.shell_radius])
def test_new_page_of_1400_pixels_shows_sphere_and_goal_beside_no_panel(
    show, viewer, radius
) -> None:
    places = radius * np.random.default_rng(2).uniform(-20.0, 20.0, (2, 2))
    show(at(*places[0], radius=radius, goal=Goal(make_state(places[1], UPRIGHT))))
    viewer._choose_view()
    camera = viewer._server.initial_camera
    assert list(camera.look_at[:2]) == pytest.approx(places.mean(axis=0))
    ahead = np.subtract(camera.look_at, camera.position) / np.linalg.norm(
        np.subtract(camera.look_at, camera.position))
    right = np.cross(ahead, (0.0, 0.0, 1.0)) / np.linalg.norm(np.cross(ahead, (0.0, 0.0, 1.0)))
    rays = np.column_stack((places, np.full(len(places), radius))) - camera.position
    # Pixels from the centre of the scene, which is 712 wide between the panels.
    aside = 450.0 / np.tan(0.5 * camera.fov) * (np.abs(rays @ right) + radius) / (rays @ ahead)
    assert 300.0 < aside.max() < 356.0
    assert all(map(viewer._scene.shows, places))
    assert not viewer._scene.shows(places.mean(axis=0) + 40.0 * radius * right[:2])


def test_history_is_limited_in_length_and_density() -> None:
    history = History()
    for time in np.arange(0.0, 60.0, 0.02):
        history.add(at(time, 0.0, time=float(time), goal=Goal(make_state((0.0, 0.0), UPRIGHT))))
    times = history.series()["time"]
    assert times[0] >= 29.9 and 350 <= len(times) <= 402
    assert np.allclose(history.series()["distance"], times)
    history.add(at(0.0, 0.0, time=1.0, restarted=True))
    assert history.series()["time"].tolist() == [1.0]


def test_plans_at_one_point_are_not_drawn(show, viewer) -> None:
    still = np.tile(make_state((1.0, 1.0), UPRIGHT), (5, 1))
    moving = still + np.linspace(0.0, 1.0, 5)[:, None] * np.eye(6)[0]
    for plan, there in ((still, False), (moving, True), (np.empty((0, 6)), False)):
        show(at(1.0, 1.0, plan=plan))
        assert viewer._scene._ground._plan.visible is there


def test_walls_are_drawn_once_and_removed_when_the_floor_goes(show, viewer) -> None:
    occupied = np.zeros((3, 4), dtype=bool)
    occupied[1, 1:3] = True
    grid, panel = Grid(occupied, 0.5, (1.0, 2.0, 0.0)), viewer._panel

    def shown(floor: Grid | None, **more):
        show(at(1.2, 2.2, floor=floor, **more))
        return viewer._scene._walls._mesh, "grey walls" in panel._legend.content

    assert shown(None) == (None, False)
    lines = panel._numbers.content.count("<br>")
    first, told = shown(grid, clearance=0.125)
    assert told and panel._numbers.content.count("<br>") == lines + 1
    points = first.vertices.reshape(-1, 8, 3)
    inner = [it for it in points if it[:, 0].min() > 1.0 and it[:, 0].max() < 3.0]
    # Two cells as one block, and a border of half a metre around the floor.
    assert len(inner) == 1
    assert inner[0].min(axis=0).tolist() == [1.5, 2.5, 0.0]
    assert inner[0].max(axis=0) == pytest.approx([2.5, 3.0, 0.4 * DEFAULT_RADIUS])
    assert points.min(axis=(0, 1)).tolist() == [0.5, 1.5, 0.0]
    assert points[..., :2].max(axis=(0, 1)).tolist() == [3.5, 4.0]
    assert shown(grid)[0] is first, "it is not sent again"
    assert "clearance of the plan –" in panel._numbers.content
    assert shown(Grid(~occupied, 0.5))[0] is not first
    assert shown(None) == (None, False) and "clearance" not in panel._numbers.content


def volume(mesh: Mesh) -> float:
    """Return the volume of a mesh whose faces look outwards; those on the floor may lack."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(float) for i in range(3))
    return float(np.sum(np.einsum("ij,ij->i", a, np.cross(b, c)))) / 6.0


def test_meshes_are_closed_and_face_outwards() -> None:
    shell = merged([octants(0.3, even) for even in (False, True)])
    assert np.allclose(np.linalg.norm(shell.vertices, axis=1), 0.3, atol=1e-6)
    assert volume(shell) == pytest.approx(4.0 / 3.0 * np.pi * 0.3**3, rel=0.02)
    for axis in range(3):
        disc = sector(0.5, 0.1, axis)
        assert np.allclose(np.ptp(disc.vertices[:, axis]), 0.1)
        assert volume(disc) == pytest.approx(np.pi * 0.25 * 0.1, rel=0.02)
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
    assert volume(blocks(np.array([square + 5.0, square]), 0.5)) == pytest.approx(2.0)
