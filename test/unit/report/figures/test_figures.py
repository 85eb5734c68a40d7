# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures of a complete run, and of one that has poses only."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from PIL import Image

from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.goal import Goal
from sphere_sim.evaluation.series import Series
from sphere_sim.output import colours
from sphere_sim.output.colours import css
from sphere_sim.recording.message_fields import ReportedSolve
from sphere_sim.recording.run import Run
from sphere_sim.report.figures import analysis
from sphere_sim.report.figures.analysis import rotor_torques
from sphere_sim.report.figures.animation import write_animation
from sphere_sim.report.figures.comparison import comparison, side_by_side
from sphere_sim.report.figures.paper import contact_locus, paper_panels
from sphere_sim.report.figures.style import WIDTH, save

pytestmark = pytest.mark.slow

FIGURES = {
    "panels": paper_panels,
    "locus": contact_locus,
    "error": analysis.error_over_time,
    "torque": analysis.rotor_torques,
    "solve": analysis.solve_times,
    "value": analysis.value_function,
    "momentum": analysis.momentum_over_time,
    "clearance": analysis.clearance_over_time,
    "comparison": lambda run: comparison((run, make_run())),
    "side_by_side": lambda run: side_by_side(make_run(), run, "both"),
}


def make_run(full: bool = True) -> Run:
    rng = np.random.default_rng(1)
    states = np.cumsum(rng.normal(scale=0.05, size=(60, 6)), axis=0)
    states[:, 2] += 1.0
    states[:, 2:] /= np.linalg.norm(states[:, 2:], axis=1, keepdims=True)
    times = np.linspace(0.0, 6.0, 60)
    n, g, k = (60, 1, 12) if full else (0, 0, 0)
    turns = np.outer(times[:n], (1, 2))
    return Run(
        Series(times, states), Series(times[:n], 90.0 * np.sin(turns)),
        Series(times[:n], np.cos(turns)), "run", Path("bag"),
        goals=Series(np.zeros(g), g * (Goal(np.array([0.0, 0, 1, 0, 0, 0])),), lasting=True),
        solves=Series(times[:k], tuple(
            ReportedSolve(0.002, 10.0**-i, np.nan, "solved") for i in range(k)
        )),
        momentum=Series(times[:k], np.outer(times[:k], (0.1, 0.2, 0.0))),
        pushes=Series(np.array([2.0]), np.array([[0.5, 0.0]])),
    )


@pytest.mark.parametrize("name", FIGURES)
def test_figure_of_a_run_with_poses_only_is_drawn(name, tmp_path) -> None:
    png, svg = save(FIGURES[name](make_run(False)), tmp_path, name)
    assert png.read_bytes().startswith(b"\x89PNG") and "<svg" in svg.read_text()


def test_equal_runs_give_equal_files(tmp_path) -> None:
    one, two = (
        save(FIGURES["value"](make_run()), tmp_path, name)[1] for name in ("one", "two")
    )
    assert one.read_bytes() == two.read_bytes()


def test_rotors_have_the_colours_that_they_have_on_the_page_and_runs_have_others() -> None:
    rotors = [css(colour) for colour in colours.ROTORS]
    errors, _, first, second = side_by_side(make_run(), make_run(), "both").axes
    for axes in (paper_panels(make_run()).axes[3], rotor_torques(make_run()).axes[0], first,
                 second):
        assert [line.get_color() for line in axes.lines[:2]] == rotors
    assert not {line.get_color() for line in errors.lines} & {*rotors}
    assert not {*colours.SERIES} & {*colours.ROTORS}


def test_figures_of_a_run_have_one_width() -> None:
    figures = [draw(make_run()) for draw in FIGURES.values()]
    assert {figure.get_figwidth() for figure in figures} == {WIDTH}


@pytest.mark.parametrize("name", ["panels", "error", "momentum", "solve", "side_by_side"])
def test_legends_cover_no_curve_and_no_title(name) -> None:
    figure = FIGURES[name](replace(make_run(), name="plan_keeping, computed without ROS"))
    figure.draw_without_rendering()
    legends = [(axes, axes.get_legend()) for axes in figure.axes if axes.get_legend()]
    assert legends
    for axes, legend in legends:
        extent = legend.get_window_extent()
        assert extent.y0 >= axes.get_window_extent().y1 - 1.0
        words = axes.get_title(loc="left")
        titles = [it for it in axes.findobj(Text) if words and it.get_text() == words]
        assert all(title.get_window_extent().x1 <= extent.x0 for title in titles)


def test_momentum_is_drawn_with_the_pushes_and_what_a_rotor_can_hold() -> None:
    (axes,) = analysis.momentum_over_time(make_run()).axes
    lines = {line.get_label(): line for line in axes.lines}
    assert np.max(lines["$H_y$"].get_ydata()) == pytest.approx(0.2 * make_run().solves.times[-1])
    upright = [line for line in axes.lines if list(line.get_xdata()) == [2.0, 2.0]]
    limits = [line.get_ydata()[0] for line in axes.lines if line.get_linestyle() == ":"]
    assert len(upright) == 1
    # 100 rad/s of a rotor; a push of 1 N s, 0.3 N m s, takes 37.5 rad/s.
    np.testing.assert_allclose(limits, [-0.8, 0.8], rtol=1e-6)


def test_animation_is_written_until_the_run_ends(tmp_path) -> None:
    run = make_run()
    shorter = Series(0.1 * run.times, run.states)
    write_animation(replace(run, poses=shorter), tmp_path / "run.gif")
    with Image.open(tmp_path / "run.gif") as picture:
        assert picture.size == (640, 300) and picture.n_frames > 5


def test_what_is_occupied_is_drawn_under_the_path_where_it_is() -> None:
    occupied = np.zeros((80, 80), dtype=bool)
    occupied[41, 40:44] = True
    # Turned by a quarter: columns go along y, rows towards -x.
    grid = Grid(occupied, 0.25, (10.0, -10.0, 0.5 * np.pi))
    run = replace(make_run(), floors=Series(np.zeros(1), (grid,), lasting=True))
    path = paper_panels(run).axes[2]
    (drawn,) = path.collections
    corners = [shape.vertices[:4] for shape in drawn.get_paths()]
    boxes = [(*np.round(it.min(axis=0), 9), *np.round(it.max(axis=0), 9)) for it in corners]
    assert boxes == [(-0.5, 0.0, -0.25, 1.0)]
    assert drawn.get_zorder() < min(line.get_zorder() for line in path.lines)
    low, high = run.states[:, :2].min(axis=0), run.states[:, :2].max(axis=0)
    for limits, a, b in zip((path.get_xlim(), path.get_ylim()), low, high, strict=True):
        assert limits[0] < a - 0.6 and limits[1] > b + 0.6, "what it was near is shown"
        assert limits[1] - limits[0] < 8.0, "not the whole map"
