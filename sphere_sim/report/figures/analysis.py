# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures of errors, rotor torques, solve times and the value function."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sphere_sim.evaluation.metrics import (
    SETTLED_ERROR,
    angle_errors,
    position_errors,
    state_errors,
)
from sphere_sim.output.round_numbers import three_digits
from sphere_sim.recording.run import Run
from sphere_sim.report.figures.style import (
    COLOURS,
    DASHES,
    GREY,
    ORANGE,
    SMALLEST_ERROR,
    VERMILION,
    mark_missing,
    styled,
)


def error_over_time(run: Run) -> Figure:
    """Draw the error in R^6, the distance and the angle to the goal on a logarithmic scale."""
    with styled():
        figure = Figure(figsize=(8.0, 4.0), layout="constrained")
        axes = figure.subplots()
        if run.goal is not None:
            parts = (
                (state_errors, r"$\|x - x_d\|$ [m, -]"),
                (position_errors, "distance [m]"),
                (angle_errors, "angle [rad]"),
            )
            for i, (measure, label) in enumerate(parts):
                times, errors = run.errors(measure)
                axes.semilogy(times, np.maximum(errors, SMALLEST_ERROR), DASHES[i],
                              color=COLOURS[i], label=label)
            axes.axhline(SETTLED_ERROR, color=GREY, linewidth=1.0, linestyle=":")
            axes.annotate("settled below", (0.005, SETTLED_ERROR), color=GREY, fontsize=8,
                          xycoords=("axes fraction", "data"), ha="left", va="bottom")
            axes.set_xlabel("time [s]")
            axes.set_ylabel("error")
            axes.set_xlim(0.0, run.times[-1])
            axes.legend()
        else:
            mark_missing(axes, "goal")
        axes.set_title("Error over time")
    return figure


def rotor_torques(run: Run) -> Figure:
    """Draw the rotor torques (Eqs. 44 to 46), and the torque of the largest acceleration.

    For Table 1 that is the bound on all torques that the paper states.
    """
    bound = run.robot.full_torque
    with styled():
        figure = Figure(figsize=(8.0, 4.0), layout="constrained")
        axes = figure.subplots()
        axes.set_title("Rotor torques")
        if np.any(np.isfinite(run.rotor_torques)):
            for i in range(2):
                axes.plot(run.joint_times, run.rotor_torques[:, i], DASHES[i], color=COLOURS[i],
                          label=f"$M_{i + 1}$")
            for side in (-bound, bound):
                axes.axhline(side, color=GREY, linewidth=1.0, linestyle=":")
            axes.annotate(f"{three_digits(bound)} N m, at the largest acceleration of a rotor",
                          (0.995, bound), xycoords=("axes fraction", "data"), color=GREY,
                          fontsize=8, ha="right", va="bottom")
            axes.set_xlabel("time [s]")
            axes.set_ylabel("torque [N m]")
            axes.set_xlim(0.0, max(float(run.joint_times[-1]), 1e-3))
            axes.margins(y=0.12)
            axes.legend(loc="lower right", ncols=2)
        else:
            mark_missing(axes, "rotor torques")
    return figure


def solve_times(run: Run) -> Figure:
    """Draw the solve times over time and as a histogram, with median and 99th percentile."""
    with styled():
        figure = Figure(figsize=(8.0, 3.6), layout="constrained")
        over_time, histogram = figure.subplots(1, 2)
        durations = 1e3 * run.solves.durations
        known = np.isfinite(durations)
        over_time.set_title("Solve time")
        if np.any(known):
            over_time.plot(run.solves.times[known], durations[known], ".", color=COLOURS[0])
            over_time.set_xlabel("time [s]")
            over_time.set_ylabel("solve time [ms]")
            over_time.set_ylim(bottom=0.0)
            # By their number: by the spread, one long solve would take any number of bins.
            histogram.hist(durations[known], bins="sturges", color=COLOURS[0], alpha=0.85)
            for percent, colour, name in ((50, ORANGE, "median"), (99, VERMILION, "p99")):
                value = float(np.percentile(durations[known], percent))
                label = f"{name} {three_digits(value)} ms"
                histogram.axvline(value, color=colour, label=label)
            histogram.set_xlabel("solve time [ms]")
            histogram.set_ylabel("solves")
            histogram.yaxis.set_major_locator(MaxNLocator(integer=True))
            histogram.legend()
        else:
            mark_missing(over_time, "solve times")
            histogram.set_visible(False)
    return figure


def value_function(run: Run) -> Figure:
    """Draw the value of the optimal control problem at each sample, which should decrease.

    The value of a minimum-time problem is the time to go.
    """
    with styled():
        figure = Figure(figsize=(8.0, 4.0), layout="constrained")
        axes = figure.subplots()
        costs, to_go = run.solves.costs, run.solves.to_go
        positive = np.isfinite(costs) & (costs > 0.0)
        reported = np.isfinite(to_go)
        axes.set_title("Value of the optimal control problem")
        if np.any(reported):
            axes.plot(run.solves.times[reported], to_go[reported], ".-", color=COLOURS[0],
                      linewidth=1.0)
            axes.set_ylim(bottom=0.0)
            axes.set_xlabel("time [s]")
            axes.set_ylabel("time to the goal, by the plan [s]")
        elif np.any(positive):
            axes.semilogy(run.solves.times[positive], costs[positive], ".-", color=COLOURS[0],
                          linewidth=1.0)
            axes.set_xlabel("time [s]")
            axes.set_ylabel("value $V_N^*$")
        else:
            mark_missing(axes, "values")
    return figure
