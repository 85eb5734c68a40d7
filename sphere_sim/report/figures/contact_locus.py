# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of the contact points on the shell and circle Gamma, as the paper's Fig. 7."""

from copy import copy
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sphere_nmpc.model.state import Vector, contact_points
from sphere_sim.recording.run import Run
from sphere_sim.report.figures.style import BLACK, BLUE, GREY, VERMILION, styled


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
        figure = Figure(figsize=(10.0, 5.2), layout="constrained")
        views = ((22.0, -50.0), (-22.0, 130.0))
        for place, (elevation, azimuth) in enumerate(views):
            axes = figure.add_subplot(1, 2, place + 1, projection="3d")
            axes.view_init(elevation, azimuth)
            axes.set_proj_type("ortho")
            axes.set_box_aspect((1.0, 1.0, 1.0), zoom=1.5)
            axes.set_axis_off()
            towards = _towards_viewer(elevation, azimuth)
            _draw_graticule(axes, towards)
            _draw_curve(axes, circle, towards, VERMILION, 2.0, r"circle $\Gamma$")
            _draw_curve(axes, points, towards, BLUE, 1.8, "contact point")
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
    for side, alpha, label in ((near, 1.0, name), (~near, 0.22, None)):
        # Values of nan interrupt the curve; otherwise it would cross the sphere.
        kept = np.where(side[:, None], points, np.nan)
        axes.plot(*kept.T, color=colour, linewidth=width, alpha=alpha, label=label)


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
    for direction, name in (((1, 0, 0), "rotor 1"), ((0, 1, 0), "rotor 2")):
        for sign in (1.0, -1.0):
            place = sign * np.array(direction, dtype=float)
            if float(place @ towards) < 0.0:
                continue
            axes.scatter(*place, marker="s", s=18, color=VERMILION, depthshade=False)
            axes.text(
                *(place - (0.0, 0.0, 0.09)), name, color=BLACK, fontsize=8, ha="center", va="top",
                zorder=20,
                bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.0},
            )
