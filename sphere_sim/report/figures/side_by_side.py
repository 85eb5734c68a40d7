# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of two strategies on the same scenario."""

import numpy as np
from matplotlib.figure import Figure

from sphere_sim.evaluation.metrics import SETTLED_ERROR, settling_index
from sphere_sim.recording.run import Run
from sphere_sim.report.figures.paper_panels import draw_rotor_speeds
from sphere_sim.report.figures.style import (
    BLACK,
    COLOURS,
    DASHES,
    GREY,
    SMALLEST_ERROR,
    literal,
    styled,
)

_AFTERWARDS = 2.0
"""Time shown after both runs have settled [s]."""


def side_by_side(first: Run, second: Run, title: str | None = None) -> Figure:
    """Draw errors and paths of two runs together, and the rotor speeds of each.

    Parameters
    ----------
    first, second : Run
        The runs; their names are in the legend.
    title : str, optional
        Title above the panels.

    Returns
    -------
    Figure
    """
    runs = (first, second)
    end = min(max(run.times[-1] for run in runs), _end_of_interest(runs))
    with styled():
        figure = Figure(figsize=(10.0, 7.2), layout="constrained")
        error, path, *speeds = figure.subplots(2, 2).flat
        for i, run in enumerate(runs):
            times, errors = run.errors()
            error.semilogy(times, np.maximum(errors, SMALLEST_ERROR), DASHES[i], color=COLOURS[i],
                           label=literal(run.name))
            path.plot(run.states[:, 0], run.states[:, 1], DASHES[i], color=COLOURS[i])
            draw_rotor_speeds(speeds[i], run)
            speeds[i].set_title(f"{'cd'[i]}: rotor speeds, {literal(run.name)}")
            speeds[i].set_xlim(0.0, end)
        path.plot(*first.states[0, :2], "o", color=BLACK, markersize=6, label="start")
        if first.goal is not None:
            path.plot(*first.goal[:2], "*", color=BLACK, markersize=13, label="goal", zorder=3)
        path.set_aspect("equal", adjustable="datalim")
        path.set_title("b: path on the plane")
        path.set_xlabel("x [m]")
        path.set_ylabel("y [m]")
        path.legend(loc="best")
        error.axhline(SETTLED_ERROR, color=GREY, linewidth=1.0, linestyle=":")
        error.set_xlim(0.0, end)
        error.set_title("a: error; settled below the dotted line")
        error.set_xlabel("time [s]")
        error.set_ylabel(r"$\|x - x_d\|$ [m, -]")
        error.legend(loc="best")
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontsize=11.0)
    return figure


def _end_of_interest(runs: tuple[Run, ...]) -> float:
    """Return a time after both runs have settled [s]; inf if one has not."""
    ends = []
    for run in runs:
        times, errors = run.errors()
        index = settling_index(errors)
        ends.append(float("inf") if index is None else float(times[index]))
    return max(ends) + _AFTERWARDS
