# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures that compare runs: any number of them, or two strategies on the same scenario."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sphere_sim.evaluation.metrics import SETTLED_ERROR, settling_index
from sphere_sim.recording.run import Run
from sphere_sim.report.figures.paper import draw_rotor_speeds
from sphere_sim.report.figures.style import (
    BLACK,
    COLOURS,
    DASHES,
    GREY,
    SMALLEST_ERROR,
    WIDTH,
    from_start,
    label,
    legend_above,
    literal,
    mark_missing,
    styled,
)

_AFTERWARDS = 2.0
"""Time shown after two runs have settled [s]."""


def comparison(runs: Sequence[Run]) -> Figure:
    """Draw errors, paths, largest rotor speeds and solve times of several runs together."""
    with styled():
        figure = Figure(figsize=(WIDTH, 7.2), layout="constrained")
        error, path, speed, solve = figure.subplots(2, 2).flat
        _draw_errors_and_paths(error, path, runs)
        for i, run in enumerate(runs):
            style = _style(i, run)
            path.plot(*run.states[0, :2], "o", color=style["color"], markersize=5)
            if run.goal is not None:
                path.plot(*run.goal[:2], "*", color=style["color"], markersize=11)
            if speeds := run.rotor_speeds:
                speed.plot(speeds.times, np.max(np.abs(speeds.values), axis=1), **style)
            if run.solves:
                order = np.sort(1e3 * run.solves.column("duration"))
                solve.step(order, np.linspace(0.0, 1.0, order.size), where="post", **style)
        label(speed, "time [s]", r"max $|u_i|$ [rad/s]", "c: larger rotor speed")
        label(solve, "solve time [ms]", "share of solves", "d: solve time")
        for axes in (speed, solve):
            if not axes.lines:
                mark_missing(axes, "such series")
        solve.set_xscale("log")
        _add_legend(figure, error)
    return figure


def side_by_side(first: Run, second: Run, title: str) -> Figure:
    """Draw errors and paths of two runs together, and the rotor speeds of each."""
    runs = (first, second)
    end = min(max(run.times[-1] for run in runs), _end_of_interest(runs))
    with styled():
        figure = Figure(figsize=(WIDTH, 7.2), layout="constrained")
        error, path, *speeds = figure.subplots(2, 2).flat
        _draw_errors_and_paths(error, path, runs)
        for i, run in enumerate(runs):
            draw_rotor_speeds(speeds[i], run)
            speeds[i].set_title(f"{'cd'[i]}: {literal(run.name)}")
            from_start(speeds[i], end)
        path.plot(*first.states[0, :2], "o", color=BLACK, markersize=6, label="start")
        if first.goal is not None:
            path.plot(*first.goal[:2], "*", color=BLACK, markersize=13, label="goal", zorder=3)
        legend_above(path)
        from_start(error, end)
        _add_legend(figure, error)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11.0)
    return figure


def _style(i: int, run: Run) -> dict[str, Any]:
    """Return colour, dashes and label of the lines of run number `i`."""
    return {"color": COLOURS[i % len(COLOURS)], "linestyle": DASHES[i % len(DASHES)],
            "label": literal(run.name)}


def _add_legend(figure: Figure, axes: Axes) -> None:
    """Add the legend of the runs, which a panel has drawn, below all panels."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(handles)))


def _draw_errors_and_paths(error: Axes, path: Axes, runs: Sequence[Run]) -> None:
    for i, run in enumerate(runs):
        shown = np.maximum(run.goal_errors[:, 0], SMALLEST_ERROR)
        error.semilogy(run.times, shown, **_style(i, run))
        path.plot(*run.states[:, :2].T, **{**_style(i, run), "label": None})
    error.axhline(SETTLED_ERROR, color=GREY, linewidth=1.0, linestyle=":")
    label(error, "time [s]", r"$\|x - x_d\|$ [m, -]", "a: error; settled below the dotted line")
    path.set_aspect("equal", adjustable="datalim")
    label(path, "x [m]", "y [m]", "b: path on the plane")


def _end_of_interest(runs: Sequence[Run]) -> float:
    """Return a time after all runs have settled [s]; inf if one has not."""
    ends = []
    for run in runs:
        index = settling_index(run.goal_errors[:, 0])
        ends.append(float("inf") if index is None else float(run.times[index]))
    return max(ends) + _AFTERWARDS
