# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure as the paper's Figs. 3 to 6: position, Euler parameters, path and rotor speeds."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sphere_nmpc.model.state import POSITION, QUATERNION
from sphere_sim.recording.run import Run
from sphere_sim.report.figures.style import (
    BLACK,
    BLUE,
    COLOURS,
    DASHES,
    GREY,
    VERMILION,
    mark_missing,
    styled,
)


def paper_panels(run: Run, title: str | None = None) -> Figure:
    """Draw the four panels of a run, with a title above them if it is given."""
    with styled():
        figure = Figure(figsize=(10.0, 7.2), layout="constrained")
        position, euler, path, speeds = figure.subplots(2, 2).flat
        _draw_position(position, run)
        _draw_euler_parameters(euler, run)
        _draw_path(path, run)
        draw_rotor_speeds(speeds, run)
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontsize=11.0)
    return figure


def _draw_position(axes: Axes, run: Run) -> None:
    """Draw x and y of centre and goal over time."""
    for i, name in enumerate(("x", "y")):
        axes.plot(run.times, run.states[:, i], DASHES[i], color=COLOURS[i], label=name)
    _draw_goal_lines(axes, run, POSITION)
    _over_time(axes, run, "a: position of the sphere", "position [m]")
    axes.legend(loc="best", ncols=2)


def _draw_euler_parameters(axes: Axes, run: Run) -> None:
    """Draw the four components of the quaternion and of that of the goal over time."""
    for i in range(4):
        values = run.states[:, QUATERNION][:, i]
        axes.plot(run.times, values, DASHES[i], color=COLOURS[i], label=f"$q_{i + 1}$")
    _draw_goal_lines(axes, run, QUATERNION)
    _over_time(axes, run, "b: Euler parameters", "Euler parameters [-]")
    axes.set_ylim(-1.08, 1.08)
    axes.legend(loc="best", ncols=4)


def _draw_path(axes: Axes, run: Run) -> None:
    """Draw the path of the centre on the plane with start and goal."""
    x, y = run.states[:, 0], run.states[:, 1]
    axes.plot(x, y, color=BLUE)
    axes.plot(x[0], y[0], "o", color=BLACK, markersize=6, label="start")
    goal = run.goal
    if goal is not None:
        axes.plot(goal[0], goal[1], "*", color=VERMILION, markersize=13, label="goal", zorder=3)
    # Motions that are small beside the sphere must not fill the panel: it shows a radius at least.
    middle = 0.5 * np.array((x.min() + x.max(), y.min() + y.max()))
    half = 0.5 * run.robot.shell_radius
    axes.update_datalim((middle - half, middle + half))
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("c: path on the plane")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(loc="best")


def draw_rotor_speeds(axes: Axes, run: Run) -> None:
    """Draw the rotor speeds over time, with their limits."""
    limit = run.robot.max_rotor_speed
    if run.joint_times.size:
        for i in range(2):
            values = run.rotor_speeds[:, i]
            axes.plot(run.joint_times, values, DASHES[i], color=COLOURS[i], label=f"$u_{i + 1}$")
        for side in (-limit, limit):
            axes.axhline(side, color=GREY, linewidth=1.0, linestyle=":")
        axes.set_ylim(-1.12 * limit, 1.12 * limit)
        axes.legend(loc="best", ncols=2)
        _over_time(axes, run, "d: rotor speeds", "rotor speed [rad/s]")
    else:
        axes.set_title("d: rotor speeds")
        mark_missing(axes, "rotor speeds")


def _draw_goal_lines(axes: Axes, run: Run, part: slice) -> None:
    goal = run.goal
    if goal is not None:
        for i, value in enumerate(goal[part]):
            axes.axhline(value, color=COLOURS[i], linewidth=0.9, linestyle=":", alpha=0.8)


def _over_time(axes: Axes, run: Run, title: str, label: str) -> None:
    axes.set_title(title)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(label)
    axes.set_xlim(0.0, max(float(run.times[-1]), 1e-3))
