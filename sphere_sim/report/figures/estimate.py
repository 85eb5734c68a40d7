# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of the poses that an odometry estimates: path and deviations, and errors over time."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from sphere_nmpc.estimation.odometry.pose_estimate import PoseEstimate
from sphere_nmpc.model.state import Vector
from sphere_sim.evaluation.series import Series
from sphere_sim.report.figures.style import (
    ANGLE,
    DISTANCE,
    GREY,
    PATH,
    WIDTH,
    from_start,
    label,
    literal,
    styled,
)

_ELLIPSES = 12
"""Number of ellipses along a path."""
_TWO = 2.0
"""Standard deviations that ellipses and bands show [-]."""


def estimated_poses(
    estimates: Sequence[PoseEstimate], table: Mapping[str, Vector],
    references: Mapping[str, tuple[Series, Vector]],
) -> Figure:
    """Draw the path with ellipses of two standard deviations, and deviations over time.

    `table` has the columns of `estimate_table`. The `references` by name have poses, and the
    distances [m] and angles about the vertical [rad] of the estimates from them, shape (n, 2).
    """
    with styled():
        figure = Figure(figsize=(WIDTH, 5.0), layout="constrained")
        grid = figure.add_gridspec(2, 2)
        plane = figure.add_subplot(grid[:, 0])
        for name, (poses, _) in references.items():
            many = len(poses) > len(estimates) // 10
            plane.plot(poses.values[:, 0], poses.values[:, 1], "--" if many else "x", color=GREY,
                       label=literal(name))
        plane.plot(table["x"], table["y"], color=PATH, label="estimated")
        for k in np.linspace(0, len(estimates) - 1, min(_ELLIPSES, len(estimates))).astype(int):
            variances, axes = np.linalg.eigh(estimates[k].covariance[:2, :2])
            sides = 2.0 * _TWO * np.sqrt(np.maximum(variances, 0.0))
            angle = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
            plane.add_patch(Ellipse(
                estimates[k].pose[:2], sides[1], sides[0], angle=float(angle), color=PATH,
                alpha=0.25,
            ))
        plane.set_aspect("equal", adjustable="datalim")
        label(plane, "x [m]", "y [m]", "Path, with ellipses of two standard deviations")
        plane.legend()
        times = table["time_s"] - table["time_s"][0]
        for row, (column, unit, factor, colour) in enumerate((
            ("position", "mm", 1e3, DISTANCE), ("heading", "deg", np.degrees(1.0), ANGLE),
        )):
            over = figure.add_subplot(grid[row, 1])
            band = table[f"{column}_deviation_{'m' if row == 0 else 'rad'}"]
            over.fill_between(times, 0.0, _TWO * factor * band, color=colour, alpha=0.25)
            for name, (poses, errors) in references.items():
                over.plot(poses.times - table["time_s"][0], factor * np.abs(errors[:, row]), ".",
                          markersize=2.5, color=colour, label=f"from {literal(name)}")
                over.legend()
            from_start(over, times[-1])
            label(over, "time [s]", f"{column} [{unit}]",
                  f"{column.capitalize()}, with two standard deviations")
    return figure
