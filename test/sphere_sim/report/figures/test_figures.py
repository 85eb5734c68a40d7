# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures of a complete run, and of one that has poses only."""

from pathlib import Path

import numpy as np
import pytest

from sphere_nmpc.model.drift import NO_DRIFT
from sphere_sim.recording.run import Momentum, Run, Solves
from sphere_sim.report.figures import analysis
from sphere_sim.report.figures.contact_locus import contact_locus
from sphere_sim.report.figures.momentum import momentum_over_time
from sphere_sim.report.figures.paper_panels import paper_panels
from sphere_sim.report.figures.style import save

FIGURES = {
    "panels": paper_panels,
    "locus": contact_locus,
    "error": analysis.error_over_time,
    "torque": analysis.rotor_torques,
    "solve": analysis.solve_times,
    "value": analysis.value_function,
    "momentum": momentum_over_time,
}


def make_run(full: bool = True) -> Run:
    rng = np.random.default_rng(1)
    states = np.cumsum(rng.normal(scale=0.05, size=(60, 6)), axis=0)
    states[:, 2] += 1.0
    states[:, 2:] /= np.linalg.norm(states[:, 2:], axis=1, keepdims=True)
    times = np.linspace(0.0, 6.0, 60)
    n, g, k = (60, 1, 12) if full else (0, 0, 0)
    return Run(
        name="run", path=Path("bag"), origin=0.0, times=times, states=states,
        joint_times=times[:n], rotor_speeds=90.0 * np.sin(np.outer(times[:n], (1, 2))),
        rotor_torques=np.cos(np.outer(times[:n], (1, 2))), goal_times=np.zeros(g),
        goals=np.tile([0.0, 0, 1, 0, 0, 0], (g, 1)), plans=(),
        solves=Solves(times[:k], np.full(k, 0.002), 10.0 ** -np.arange(k, dtype=float),
                      ("solved",) * k),
        momentum=Momentum(times[:k], np.outer(times[:k], (0.1, 0.2, 0.0)),
                          (NO_DRIFT,) * k, np.array([2.0]), np.array([[0.5, 0.0]])),
    )


@pytest.mark.parametrize("name", FIGURES)
@pytest.mark.parametrize("full", [True, False])
def test_figure_is_drawn_and_saved(name, full, tmp_path) -> None:
    files = save(FIGURES[name](make_run(full)), tmp_path, name)
    assert [file.suffix for file in files] == [".png", ".svg"]
    assert files[0].read_bytes().startswith(b"\x89PNG")
    text = files[1].read_text()
    assert "<svg" in text and "href=\"http" not in text


def test_missing_series_are_marked_in_the_figure() -> None:
    words = [t.get_text() for axes in paper_panels(make_run(False)).axes for t in axes.texts]
    assert "no rotor speeds in this bag" in words


def test_panels_show_the_quantities_of_the_paper() -> None:
    axes = paper_panels(make_run()).axes
    assert [a.get_title(loc="left")[:2] for a in axes] == ["a:", "b:", "c:", "d:"]
    drawn = {line.get_label() for a in axes for line in a.lines}
    assert {"x", "y", "$q_1$", "$q_4$", "$u_1$", "$u_2$", "start", "goal"} <= drawn
    limits = [line.get_ydata()[0] for line in axes[3].lines if line.get_linestyle() == ":"]
    assert {-100.0, 100.0} <= set(limits)


def test_momentum_is_drawn_with_the_pushes_and_what_a_rotor_can_hold() -> None:
    (axes,) = momentum_over_time(make_run()).axes
    lines = {line.get_label(): line for line in axes.lines}
    assert np.max(lines["$H_y$"].get_ydata()) == pytest.approx(0.2 * make_run().solves.times[-1])
    upright = [line for line in axes.lines if list(line.get_xdata()) == [2.0, 2.0]]
    limits = [line.get_ydata()[0] for line in axes.lines if line.get_linestyle() == ":"]
    assert len(upright) == 1
    # 100 rad/s of a rotor; a push of 1 N s, 0.3 N m s, takes 37.5 rad/s.
    np.testing.assert_allclose(limits, [-0.8, 0.8], rtol=1e-6)


def test_equal_runs_give_equal_files(tmp_path) -> None:
    for name in ("one", "two"):
        save(paper_panels(make_run()), tmp_path, name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
