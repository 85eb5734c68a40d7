# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Files of a report: summary, tables, figures, page and animations."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from sphere_sim.output.files import printable, write_atomically
from sphere_sim.recording.run import Run
from sphere_sim.report.figures import analysis
from sphere_sim.report.figures.animation import write_animation
from sphere_sim.report.figures.comparison import comparison
from sphere_sim.report.figures.paper import contact_locus, paper_panels
from sphere_sim.report.figures.style import save
from sphere_sim.report.page import write_page
from sphere_sim.report.reported import (
    Reported,
    floor_metrics,
    goal_table,
    metrics_of,
    motion_table,
    odometry_metrics,
    solve_table,
    write_csv,
)

FIGURES: dict[str, tuple[Callable[[Run], Figure], str]] = {
    "panels": (
        paper_panels,
        "Position, Euler parameters, path and rotor speeds; dotted: the goal and the limits.",
    ),
    "error": (analysis.error_over_time, "Error in the norm of the state, distance and angle."),
    "contact": (
        contact_locus, "Contact points on the shell; the locus crosses circle Γ at a right angle.",
    ),
    "torque": (analysis.rotor_torques, "Torques of the rotors' motors."),
    "solve_time": (analysis.solve_times, "Solve times, over time and as a histogram."),
    "value": (analysis.value_function, "Value of the optimal control problem at each sample."),
}
"""Figures of each run: file name, function that draws it, and caption."""
_OF_MOMENTUM = (
    analysis.momentum_over_time,
    "Estimated angular momentum about the contact point; dotted: what a rotor can hold. "
    "Vertical lines: pushes.",
)
_OF_FLOOR = (
    analysis.clearance_over_time,
    "Distance between the sphere and what is occupied on the floor; at 0 it touches.",
)
_OF_ODOMETRY = (
    analysis.estimate_errors_over_time,
    "Error of the pose that odometry estimates: distance, and angle about the vertical.",
)


def write_report(
    reported: Sequence[Reported], out: Path, *, csv: bool, animation: bool
) -> Path:
    """Write a report into a folder that exists and return its page; several runs are compared.

    Numbers are written before figures, and animations, the largest files, last, with the page once
    more: on a full disk the most important files exist, and OSError names the one that cannot be
    written.
    """
    summary = {one.recording.name: _summary(one) for one in reported}
    write_atomically(out / "summary.json", json.dumps(summary, indent=2) + "\n")
    for one in reported:
        tables = {
            "motion": motion_table(one.recording), "solves": solve_table(one.recording),
            "goals": goal_table(one),
        }
        for name, table in tables.items() if csv else ():
            write_csv(table, out / f"{one.prefix}{name}.csv")
    runs = {prefix: run for one in reported for prefix, run in one.runs.items()}
    figures: list[tuple[str, str, Path]] = []
    if len(runs) > 1:
        caption = "Errors, paths, rotor speeds and solve times of all runs."
        drawn = comparison(list(runs.values()))
        figures.append(("Comparison", caption, save(drawn, out, "comparison")[1]))
    for prefix, run in runs.items():
        own = {"momentum": _OF_MOMENTUM} if run.has_momentum else {}
        own |= {"clearance": _OF_FLOOR} if run.has_floor else {}
        own |= {"odometry": _OF_ODOMETRY} if odometry_metrics(run) else {}
        for name, (draw, caption) in {**FIGURES, **own}.items():
            files = save(draw(run), out, f"{prefix}{name}")
            figures.append((run.name, caption, files[1]))
    page = out / "report.html"
    write_page(page, reported, figures)
    if animation:
        for prefix, run in runs.items():
            file = out / f"{prefix}animation.gif"
            write_animation(run, file)
            places = [i for i, (heading, *_) in enumerate(figures) if heading == run.name]
            figures.insert(min(places, default=len(figures)), (run.name, "The run.", file))
        write_page(page, reported, figures)
    return page


def _summary(one: Reported) -> dict[str, object]:
    """Return the entry of a recording in summary.json, with the figures of the last goal drawn."""
    run = list(one.runs.values())[-1]
    entry: dict[str, object] = {
        "bag": printable(run.path),
        "goal": one.goals[-1] if one.goals else None,
        "metrics": _known(metrics_of(run)),
    }
    if run.has_momentum:
        entry["momentum"] = _momentum(run)
    if found := floor_metrics(one.recording):
        entry["floor"] = _known(found)
    entry |= odometry_metrics(run)
    goals = [_known(columns) for columns, _ in one.rows()]
    return {**entry, "goals": goals, "notes": list(run.notes)}


def _known(values: Mapping[str, float | str]) -> dict[str, float | str | None]:
    """Return the values with null for nan, which JSON does not have."""
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in values.items()
    }


def _momentum(run: Run) -> dict[str, object]:
    return {
        "end_nms": run.momentum.values[-1].tolist() if run.momentum else None,
        "pushes": [
            {"time_s": time, "impulse_ns": impulse} for time, impulse in zip(
                run.pushes.times.tolist(), run.pushes.values.tolist(), strict=True
            )
        ],
    }
