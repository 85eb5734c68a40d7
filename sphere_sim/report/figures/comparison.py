# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure that compares several runs."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from sphere_sim.evaluation.metrics import SETTLED_ERROR
from sphere_sim.recording.run import Run
from sphere_sim.report.figures.style import (
    COLOURS,
    DASHES,
    GREY,
    SMALLEST_ERROR,
    literal,
    mark_missing,
    styled,
)


def comparison(runs: Sequence[Run]) -> Figure:
    """Draw errors, paths, largest rotor speeds and solve times of several runs together."""
    with styled():
        figure = Figure(figsize=(10.0, 7.2), layout="constrained")
        error, path, speed, solve = figure.subplots(2, 2).flat
        for i, run in enumerate(runs):
            style = {"color": COLOURS[i % len(COLOURS)], "linestyle": DASHES[i % len(DASHES)],
                     "label": literal(run.name)}
            times, errors = run.errors()
            error.semilogy(times, np.maximum(errors, SMALLEST_ERROR), **style)
            path.plot(run.states[:, 0], run.states[:, 1], **style)
            path.plot(*run.states[0, :2], "o", color=style["color"], markersize=5)
            if run.goal is not None:
                path.plot(*run.goal[:2], "*", color=style["color"], markersize=11)
            if run.joint_times.size:
                speed.plot(run.joint_times, np.max(np.abs(run.rotor_speeds), axis=1), **style)
            if run.solves.times.size:
                order = np.sort(1e3 * run.solves.durations)
                solve.step(order, np.linspace(0.0, 1.0, order.size), where="post", **style)
        error.axhline(SETTLED_ERROR, color=GREY, linewidth=1.0, linestyle=":")
        path.set_aspect("equal", adjustable="datalim")
        for axes, title, horizontal, vertical in (
            (error, "a: error", "time [s]", r"$\|x - x_d\|$ [m, -]"),
            (path, "b: path on the plane", "x [m]", "y [m]"),
            (speed, "c: larger rotor speed", "time [s]", r"max $|u_i|$ [rad/s]"),
            (solve, "d: solve time", "solve time [ms]", "share of solves"),
        ):
            axes.set_title(title)
            axes.set_xlabel(horizontal)
            axes.set_ylabel(vertical)
            if not axes.lines:
                mark_missing(axes, "such series")
        solve.set_xscale("log")
        error.legend(loc="best")
    return figure
