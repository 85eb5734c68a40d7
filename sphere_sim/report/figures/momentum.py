# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of the angular momentum about the contact point."""

from matplotlib.figure import Figure

from sphere_sim.recording.run import Run
from sphere_sim.report.figures.style import COLOURS, DASHES, GREY, mark_missing, styled


def momentum_over_time(run: Run) -> Figure:
    """Draw the momentum that the controller estimated, the pushes, and what a rotor can hold."""
    momentum = run.momentum
    limit = run.robot.rotor_axial_inertia * run.robot.max_rotor_speed
    with styled():
        figure = Figure(figsize=(8.0, 4.0), layout="constrained")
        axes = figure.subplots()
        axes.set_title("Angular momentum about the contact point")
        for time in momentum.push_times:
            axes.axvline(time, color=GREY, linewidth=1.0)
        if momentum.times.size:
            for i, name in enumerate("xyz"):
                axes.step(momentum.times, momentum.values[:, i], linestyle=DASHES[i],
                          where="post", color=COLOURS[i], label=f"$H_{name}$")
            for side in (-limit, limit):
                axes.axhline(side, color=GREY, linewidth=1.0, linestyle=":")
            axes.set_xlabel("time [s]")
            axes.set_ylabel("momentum [N m s; world]")
            axes.set_xlim(0.0, max(float(run.times[-1]), 1e-3))
            axes.legend(loc="lower right", ncols=3)
        else:
            mark_missing(axes, "momentum")
    return figure
