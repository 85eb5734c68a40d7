# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures as the paper's: the panels of Figs. 3 to 6, and the contact points of Fig. 7."""

from copy import copy
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, contact_points
from sphere_sim.output.floor_shapes import bordered, cropped, outlines
from sphere_sim.recording.run import Run
from sphere_sim.report.figures.style import (
    BLACK,
    COLOURS,
    DASHES,
    GAMMA,
    GOAL,
    GREY,
    PATH,
    ROTORS,
    TRACE,
    WALL,
    WIDTH,
    draw_limits,
    label,
    label_over_time,
    legend_above,
    mark_missing,
    styled,
)


def paper_panels(run: Run, title: str | None = None) -> Figure:
    """Draw the four panels of a run, with a title above them if it is given."""
    with styled():
        figure = Figure(figsize=(WIDTH, 7.2), layout="constrained")
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
    label_over_time(axes, run.times[-1], "position [m]", "a: position of the sphere")


def _draw_euler_parameters(axes: Axes, run: Run) -> None:
    """Draw the four components of the quaternion and of that of the goal over time."""
    for i in range(4):
        values = run.states[:, QUATERNION][:, i]
        axes.plot(run.times, values, DASHES[i], color=COLOURS[i], label=f"$q_{i + 1}$")
    _draw_goal_lines(axes, run, QUATERNION)
    label_over_time(axes, run.times[-1], "Euler parameters [-]", "b: Euler parameters")
    axes.set_ylim(-1.08, 1.08)


def _draw_path(axes: Axes, run: Run) -> None:
    """Draw the path of the centre on the plane with start and goal, and what is occupied there."""
    x, y = run.states[:, 0], run.states[:, 1]
    axes.plot(x, y, color=PATH)
    axes.plot(x[0], y[0], "o", color=BLACK, markersize=6, label="start")
    goal = run.goal
    if goal is not None:
        axes.plot(goal[0], goal[1], "*", color=GOAL, markersize=13, label="goal", zorder=3)
    # Motions that are small beside the sphere must not fill the panel: it shows a radius at least.
    middle = 0.5 * np.array((x.min() + x.max(), y.min() + y.max()))
    half = 0.5 * run.robot.shell_radius
    axes.update_datalim((middle - half, middle + half))
    _draw_floor(axes, run)
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")
    label(axes, "x [m]", "y [m]", "c: path on the plane")
    legend_above(axes)


def _draw_floor(axes: Axes, run: Run) -> None:
    """Draw what is occupied around a path at its end, and extend the panel to what it was near."""
    grid = run.floors.at(float(run.times[-1]))
    if grid is None:
        return
    places, reach = run.states[:, POSITION], 2.0 * run.robot.shell_radius
    low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
    axes.update_datalim((low, high))
    # Panels are wider or higher than the path.
    more = np.max(high - low)
    part = cropped(bordered(grid), low - more, high + more)
    if part is not None:
        axes.add_collection(
            PolyCollection(list(outlines(part)), facecolor=WALL, linewidth=0.0, antialiased=False,
                           zorder=0.5),
            autolim=False,
        )


def draw_rotor_speeds(axes: Axes, run: Run) -> None:
    """Draw the rotor speeds over time, with their limits."""
    limit = run.robot.max_rotor_speed
    speeds = run.rotor_speeds
    if np.any(np.isfinite(speeds.values)):
        for i in range(2):
            values = speeds.values[:, i]
            axes.plot(speeds.times, values, DASHES[i], color=ROTORS[i], label=f"$u_{i + 1}$")
        draw_limits(axes, limit)
        axes.set_ylim(-1.12 * limit, 1.12 * limit)
        label_over_time(axes, run.times[-1], "rotor speed [rad/s]", "d: rotor speeds")
    else:
        axes.set_title("d: rotor speeds")
        mark_missing(axes, "rotor speeds")


def _draw_goal_lines(axes: Axes, run: Run, part: slice) -> None:
    goal = run.goal
    free = part == QUATERNION and run.goals and run.goals.values[-1].orientation is Orientation.ANY
    if goal is not None and not free:
        for i, value in enumerate(goal[part]):
            axes.axhline(value, color=COLOURS[i], linewidth=0.9, linestyle=":", alpha=0.8)


def contact_locus(run: Run) -> Figure:
    """Draw the contact points on the shell.

    The far side is drawn fainter. Circle Gamma is the great circle through the rotors' axes,
    z = 0 in the body frame; the locus crosses it at right angles (Corollary 1).
    """
    radius = run.robot.shell_radius
    points = contact_points(run.states, radius) / radius
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    circle = np.stack((np.cos(angle), np.sin(angle), np.zeros_like(angle)), axis=1)
    with styled():
        figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
        views = ((22.0, -50.0), (-22.0, 130.0))
        for place, (elevation, azimuth) in enumerate(views):
            axes = figure.add_subplot(1, 2, place + 1, projection="3d")
            axes.view_init(elevation, azimuth)
            axes.set_proj_type("ortho")
            axes.set_box_aspect((1.0, 1.0, 1.0), zoom=1.5)
            axes.set_axis_off()
            towards = _towards_viewer(elevation, azimuth)
            _draw_graticule(axes, towards)
            _draw_curve(axes, circle, towards, GAMMA, 2.0, r"circle $\Gamma$")
            _draw_curve(axes, points, towards, TRACE, 1.8, "contact point")
            _draw_axes_of_rotors(axes, towards)
            for point, marker, name in ((points[0], "o", "start"), (points[-1], "*", "end")):
                size, seen = (40 if marker == "o" else 110), point @ towards > 0.0
                axes.scatter(*point, marker=marker, s=size, color=BLACK, alpha=1.0 if seen else
                             0.25, depthshade=False, label=name, zorder=10)
            axes.set_xlim(-1, 1), axes.set_ylim(-1, 1), axes.set_zlim(-1, 1)
            axes.set_title(("seen from above the rotors", "seen from the other side")[place],
                           loc="center")
        handles, labels = axes.get_legend_handles_labels()
        # Legend entries are opaque, also those of points on the far side.
        handles = [copy(handle) for handle in handles]
        for handle in handles:
            handle.set_alpha(1.0)
        figure.legend(handles, labels, loc="lower center", ncols=4, bbox_to_anchor=(0.5, 0.0))
        figure.suptitle("Contact point on the shell (body frame)", x=0.01, ha="left", fontsize=11)
    return figure


def _towards_viewer(elevation: float, azimuth: float) -> Vector:
    e, a = np.radians((elevation, azimuth))
    return np.array((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)))


def _draw_curve(
    axes: Any, points: Vector, towards: Vector, colour: str, width: float, name: str | None
) -> None:
    """Draw a curve on the unit sphere, its far side fainter."""
    near = points @ towards >= 0.0
    for side, alpha, shown in ((near, 1.0, name), (~near, 0.22, None)):
        # Values of nan interrupt the curve; otherwise it would cross the sphere.
        kept = np.where(side[:, None], points, np.nan)
        axes.plot(*kept.T, color=colour, linewidth=width, alpha=alpha, label=shown)


def _draw_graticule(axes: Any, towards: Vector) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    across = np.cross((0.0, 0.0, 1.0), towards)
    across /= np.linalg.norm(across)
    rim = np.outer(np.cos(turn), across) + np.outer(np.sin(turn), np.cross(towards, across))
    axes.plot(*rim.T, color=GREY, linewidth=0.9)
    for latitude in np.radians((-60.0, -30.0, 30.0, 60.0)):
        ring = np.stack((np.cos(latitude) * np.cos(turn), np.cos(latitude) * np.sin(turn),
                         np.full_like(turn, np.sin(latitude))), axis=1)
        _draw_curve(axes, ring, towards, GREY, 0.4, None)
    for longitude in np.radians(np.arange(0.0, 180.0, 30.0)):
        ring = np.stack((np.cos(longitude) * np.cos(turn), np.sin(longitude) * np.cos(turn),
                         np.sin(turn)), axis=1)
        _draw_curve(axes, ring, towards, GREY, 0.4, None)


def _draw_axes_of_rotors(axes: Any, towards: Vector) -> None:
    """Mark the ends of the rotors' axes."""
    for axis, colour in enumerate(ROTORS):
        for sign in (1.0, -1.0):
            place = sign * np.eye(3)[axis]
            if float(place @ towards) < 0.0:
                continue
            axes.scatter(*place, marker="s", s=40, color=colour, depthshade=False)
            axes.text(
                *(place - (0.0, 0.0, 0.09)), f"rotor {axis + 1}", color=BLACK, fontsize=8,
                ha="center", va="top", zorder=20,
                bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.0},
            )
