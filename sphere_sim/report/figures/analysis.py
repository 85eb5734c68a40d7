# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures over time: errors, torques, solves, value, momentum, clearance, odometry."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sphere_sim.evaluation.metrics import SETTLED_ERROR
from sphere_sim.output.round_numbers import three_digits
from sphere_sim.recording.run import Run
from sphere_sim.report.figures.style import (
    ANGLE,
    BLACK,
    COLOURS,
    DASHES,
    DISTANCE,
    GREY,
    ROTORS,
    SKY,
    SMALLEST_ERROR,
    VERMILION,
    WIDTH,
    draw_limits,
    from_start,
    label,
    label_over_time,
    legend_above,
    mark_missing,
    styled,
)


def error_over_time(run: Run) -> Figure:
    """Draw the error in R^6, the distance and the angle to the goal on a logarithmic scale."""
    with styled():
        figure, axes = _single("Error over time")
        if run.goal is None:
            mark_missing(axes, "goal")
            return figure
        norm, distance, angle = run.goal_errors.T
        for errors, dash, colour, name in (
            (norm, "-.", BLACK, r"$\|x - x_d\|$ [m, -]"),
            (distance, "-", DISTANCE, "distance [m]"),
            (np.degrees(angle), "--", ANGLE, "angle [°]"),
        ):
            if np.isfinite(errors).any():  # a goal may leave the orientation free
                axes.semilogy(run.times, np.maximum(errors, SMALLEST_ERROR), linestyle=dash,
                              color=colour, label=name)
        axes.axhline(SETTLED_ERROR, color=GREY, linewidth=1.0, linestyle=":")
        axes.annotate(r"$\|x - x_d\|$ settled below", (0.005, SETTLED_ERROR), color=GREY,
                      fontsize=8, xycoords=("axes fraction", "data"), ha="left", va="bottom")
        label_over_time(axes, run.times[-1], "error")
    return figure


def rotor_torques(run: Run) -> Figure:
    """Draw the rotor torques (Eqs. 44 to 46), and the torque of the largest acceleration.

    For Table 1 that is the bound on all torques that the paper states.
    """
    bound, torques = run.robot.full_torque, run.rotor_torques
    with styled():
        figure, axes = _single("Rotor torques")
        if not np.any(np.isfinite(torques.values)):
            mark_missing(axes, "rotor torques")
            return figure
        for i in range(2):
            axes.plot(torques.times, torques.values[:, i], DASHES[i], color=ROTORS[i],
                      label=f"$M_{i + 1}$")
        draw_limits(axes, bound)
        axes.annotate(f"{three_digits(bound)} N m, at the largest acceleration of a rotor",
                      (0.995, bound), xycoords=("axes fraction", "data"), color=GREY,
                      fontsize=8, ha="right", va="bottom")
        axes.margins(y=0.12)
        label_over_time(axes, torques.times[-1], "torque [N m]")
    return figure


def solve_times(run: Run) -> Figure:
    """Draw the solve times over time and as a histogram, with median and 99th percentile."""
    with styled():
        figure = Figure(figsize=(WIDTH, 4.0), layout="constrained")
        over_time, histogram = figure.subplots(1, 2)
        over_time.set_title("Solve time")
        durations = 1e3 * run.solves.column("duration")
        known = np.isfinite(durations)
        if not np.any(known):
            mark_missing(over_time, "solve times")
            histogram.set_visible(False)
            return figure
        over_time.plot(run.solves.times[known], durations[known], ".", color=COLOURS[0])
        over_time.set_ylim(bottom=0.0)
        label(over_time, "time [s]", "solve time [ms]")
        # By their number: by the spread, one long solve would take any number of bins.
        histogram.hist(durations[known], bins="sturges", color=COLOURS[0], alpha=0.85)
        for percent, colour, name in ((50, BLACK, "median"), (99, VERMILION, "p99")):
            value = float(np.percentile(durations[known], percent))
            histogram.axvline(value, color=colour, label=f"{name} {three_digits(value)} ms")
        label(histogram, "solve time [ms]", "solves")
        histogram.yaxis.set_major_locator(MaxNLocator(integer=True))
        legend_above(histogram)
    return figure


def value_function(run: Run) -> Figure:
    """Draw the value of the optimal control problem at each sample, which should decrease.

    The value of a minimum-time problem is the time to go.
    """
    with styled():
        figure, axes = _single("Value of the optimal control problem")
        times, costs = run.solves.times, run.solves.column("cost")
        to_go = run.solves.column("time_to_go")
        positive, reported = np.isfinite(costs) & (costs > 0.0), np.isfinite(to_go)
        if np.any(reported):
            axes.plot(times[reported], to_go[reported], ".-", color=COLOURS[0], linewidth=1.0)
            axes.set_ylim(bottom=0.0)
            label(axes, "time [s]", "time to the goal, by the plan [s]")
        elif np.any(positive):
            axes.set_yscale("log")
            axes.plot(times[positive], costs[positive], ".-", color=COLOURS[0], linewidth=1.0)
            label(axes, "time [s]", "value $V_N^*$")
        else:
            mark_missing(axes, "values")
    return figure


def momentum_over_time(run: Run) -> Figure:
    """Draw the momentum that the controller estimated, the pushes, and what a rotor can hold."""
    momentum = run.momentum
    with styled():
        figure, axes = _single("Angular momentum about the contact point")
        for time in run.pushes.times:
            axes.axvline(time, color=GREY, linewidth=1.0)
        if not momentum:
            mark_missing(axes, "momentum")
            return figure
        for i, name in enumerate("xyz"):
            axes.step(momentum.times, momentum.values[:, i], linestyle=DASHES[i],
                      where="post", color=COLOURS[i], label=f"$H_{name}$")
        draw_limits(axes, run.robot.rotor_axial_inertia * run.robot.max_rotor_speed)
        label_over_time(axes, run.times[-1], "momentum [N m s; world]")
    return figure


def clearance_over_time(run: Run) -> Figure:
    """Draw the distance between the sphere and what is occupied, and that of its plans."""
    planned = run.planned_clearances
    with styled():
        figure, axes = _single("Clearance to what is occupied")
        if planned:
            axes.step(planned.times, planned.values, linestyle=DASHES[1], where="post", color=SKY,
                      label="of the plan, reported")
        axes.plot(run.times, run.clearances, color=COLOURS[0], label="of the sphere, by its poses")
        axes.axhline(0.0, color=VERMILION, linewidth=1.0)
        axes.annotate("touch", (0.005, 0.0), color=VERMILION, fontsize=8,
                      xycoords=("axes fraction", "data"), ha="left", va="bottom")
        label_over_time(axes, run.times[-1], "clearance [m]")
    return figure


def estimate_errors_over_time(run: Run) -> Figure:
    """Draw the errors of the pose that odometry estimates: distance, and angle of the heading."""
    errors = run.estimate_errors
    with styled():
        figure = Figure(figsize=(WIDTH, 5.0), layout="constrained")
        rows = figure.subplots(2, 1, sharex=True)
        rows[0].set_title("Error of the odometry")
        for i, (axes, unit, name) in enumerate(zip(
            rows, (1e3, np.degrees(1.0)), ("position [mm]", "heading [°]"), strict=True
        )):
            axes.plot(errors.times, unit * errors.values[:, i], color=(DISTANCE, ANGLE)[i])
            axes.axhline(0.0, color=GREY, linewidth=1.0)
            label(axes, "time [s]", name)
        rows[0].label_outer()
        from_start(rows[1], run.times[-1])
    return figure


def _single(title: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(WIDTH, 4.0), layout="constrained")
    axes = figure.subplots()
    axes.set_title(title)
    return figure, axes
