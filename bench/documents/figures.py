# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures of docs/momentum.md, docs/model.md, docs/results.md and docs/floor.md.

    python bench/documents/figures.py holding --out docs/momentum.svg
    python bench/documents/model_tables.py integrator --json out/integrator.json
    python bench/documents/figures.py integrator out/integrator.json \\
        --out docs/integrator_convergence.svg
    python bench/paths.py plain --only circle eight s+0.50 --runs 1 --json out/paths.json
    python bench/documents/figures.py paths out/paths.json --out docs/paths.png
    python bench/floor_worlds.py kinds --runs 2 --json out/worlds.json
    python bench/documents/figures.py worlds out/worlds.json --out docs/floor_gallery.png
    python bench/odometry.py --parts drift others --json out/drives.json
    python bench/documents/figures.py odometry out/drives.json --out docs/odometry.png

`holding`: on the left the time at an upright goal from rotors at rest until one is at its limit.
On the right the plant with contact at an upright goal: pushed at rest after it has rolled there,
and on a slope until a rotor is at its limit. `integrator`: errors by number of steps. `paths`:
tracks of the sphere along paths and their deviations. `odometry`: position errors over the way, by
the odometry and by other methods.
"""

import argparse
import json
import math
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from tables import conditions_of
from worlds import SIDE

from sphere_nmpc.model.disturbance import (
    Disturbance,
    imbalance_of_offset,
    rest_speeds,
    slope_torque,
    time_to_saturation,
)
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import exponential
from sphere_nmpc.model.state import NO_MOMENTUM, QUATERNION, Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import Trajectory
from sphere_sim.evaluation.metrics import SETTLED_ERROR
from sphere_sim.report.figures.style import (
    BLUE,
    COLOURS,
    DASHES,
    GREY,
    PATH,
    ROTORS,
    SMALLEST_ERROR,
    VERMILION,
    styled,
)
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.single_run import closed_loop
from sphere_sim.world.disturbances import Push

ROBOT = RobotParameters()
GOAL: Vector = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
SLOPES = np.geomspace(0.03, 3.0, 41)
"""Inclinations [degree]."""
OFFSETS = np.geomspace(0.05, 5.0, 41)
"""Distances of the centre of mass from the centre of the sphere [mm]."""
HEADINGS: Vector = np.radians(np.arange(0.0, 180.0, 15.0))
START: Vector = np.array([-1.0, 0.5, 1.0, 0.0, 0.0, 0.0])
"""Start of the run with a push: on the way to the goal the constants of the plant are learnt."""
PUSH = Push(8.0, (1.0, 0.0))


def times_on_slope(angle: float) -> tuple[float, float]:
    """Return the shortest and longest time [s] over all headings on a slope of `angle` [rad]."""
    disturbance = Disturbance(slope=slope_torque(ROBOT, angle, 0.0))
    turns = [exponential(np.array([0.0, 0.0, heading])) for heading in HEADINGS]
    times = [
        time_to_saturation(NO_MOMENTUM, disturbance, turn, ROBOT.max_rotor_speed) for turn in turns
    ]
    return min(times), max(times)


def time_out_of_balance(offset: float) -> float:
    """Return the time [s] with the centre of mass `offset` [m] along the axis of a rotor."""
    imbalance = imbalance_of_offset(ROBOT, np.array([offset, 0.0, 0.0]))
    disturbance = Disturbance(imbalance=imbalance)
    return time_to_saturation(NO_MOMENTUM, disturbance, GOAL[QUATERNION], ROBOT.max_rotor_speed)


def draw_times(on_slope: Axes, out_of_balance: Axes) -> None:
    """Draw how long an upright goal can be held."""
    worst, best = np.array([times_on_slope(math.radians(angle)) for angle in SLOPES]).T
    on_slope.loglog(SLOPES, best, color=BLUE, linestyle="--", label="best heading")
    on_slope.loglog(SLOPES, worst, color=VERMILION, label="worst heading")
    on_slope.set_title("a: time on a slope")
    on_slope.set_xlabel("inclination [°]")
    on_slope.legend()
    times = [time_out_of_balance(1e-3 * offset) for offset in OFFSETS]
    out_of_balance.loglog(OFFSETS, times, color=VERMILION, label="worst orientation")
    out_of_balance.set_title("b: time out of balance, without unloading")
    out_of_balance.set_xlabel("offset of the centre of mass [mm]")
    out_of_balance.legend()
    for axes in (on_slope, out_of_balance):
        axes.set_ylabel("time until saturation [s]")


def draw_run(found: Trajectory, error: Axes, speed: Axes, name: str) -> None:
    """Draw errors and rotor speeds of a run, with the speeds of rest by the estimated momentum."""
    error.semilogy(found.times, np.maximum(found.errors, SMALLEST_ERROR), color=BLUE)
    error.axhline(SETTLED_ERROR, color=GREY, linestyle=":", label="settled below")
    error.set_title(f"{name}: error")
    error.set_ylabel(r"$\|x - x_d\|$ [m, -]")
    error.legend()
    samples = ControllerSettings().control_period * np.arange(len(found.decisions))
    rest = np.array([rest_speeds(d.momentum, GOAL[QUATERNION]) for d in found.decisions])
    for rotor, colour in enumerate(ROTORS):
        values = found.rotor_speeds.values[:, rotor]
        speed.plot(found.times, values, color=colour, label=f"rotor {rotor + 1}")
        speed.plot(samples, rest[:, rotor], color=colour, linestyle="--",
                   label=f"rotor {rotor + 1}, speed of rest")
    limit = ROBOT.max_rotor_speed
    for side, label in ((-limit, "limit"), (limit, None)):
        speed.axhline(side, color=GREY, linestyle=":", label=label)
    speed.set_ylim(-1.3 * limit, 1.3 * limit)
    speed.set_title(f"{name}: rotor speeds")
    speed.set_ylabel("rotor speed [rad/s]")
    speed.set_xlabel("time [s]")


def holding(duration: float) -> Figure:
    """Return how long momentum can be held, and two runs of a duration [s] that hold it."""
    figure = Figure(figsize=(12.0, 6.4), layout="constrained")
    axes = figure.subplots(2, 3)
    draw_times(axes[0, 0], axes[1, 0])
    for column, name, settings, scenario in (
        (1, f"c: push of 1 N s at {PUSH.time:g} s", "", Scenario(START, GOAL, push=PUSH)),
        (2, "d: slope of 0.5°", f"disturbances.slope={math.radians(0.5)}", Scenario(GOAL, GOAL)),
    ):
        conditions = conditions_of(f"simulator.plant=rigid_body {settings}", duration)
        draw_run(closed_loop(conditions, scenario), axes[0, column], axes[1, column], name)
    axes[1, 1].legend(loc="lower right")
    return figure


def integrator(measured: dict[str, Any]) -> Figure:
    """Return the errors with random speeds in the file of `model_tables.py`."""
    found = {row["names"][1]: row["runs"][0] for row in measured["rows"]
             if row["names"][0] == "random"}
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    for name, colour in (("CF4", BLUE), ("RK4", VERMILION)):
        for k, line, about in ((0, "o-", "median"), (1, "o--", "99th percentile")):
            errors = [run[name][k] for run in found.values()]
            axes.loglog(list(found), errors, line, color=colour, label=f"{name}, {about}")
    steps = np.array([8.0, 64.0])
    axes.loglog(steps, 2e-5 * (steps / 8.0) ** -4, "k:", label="order 4")
    axes.set_xticks(list(found), [str(n) for n in found])
    axes.minorticks_off()
    axes.set(ylim=(1e-10, 10.0), xlabel="steps in one sample period of 0.5 s",
             ylabel="error of the state after it, in R$^6$")
    axes.legend()
    return figure


def odometry(measured: dict[str, Any]) -> Figure:
    """Return the errors of the file of bench/odometry.py."""
    figure = Figure(figsize=(8.6, 3.3), layout="constrained")
    plants = measured["drift"]
    for axes, (plant, methods) in zip(
        figure.subplots(1, 2, sharey=True), plants.items(), strict=True
    ):
        curves = [one for one in methods.items() if "over_way_m" in one[1]]
        for (name, found), colour, dash in zip(curves, COLOURS, DASHES, strict=False):
            # At the start all errors are 0, which a logarithmic axis does not have.
            way, error = (np.array(found[key][1:]) for key in ("way_m", "over_way_m"))
            axes.semilogy(way, 1e3 * error, color=colour, linestyle=dash, label=name)
        axes.set_title(plant)
        axes.set_xlabel("way [m]")
    figure.axes[0].set_ylabel("median position error [mm]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside right")
    return figure


def paths(measured: dict[str, Any]) -> Figure:
    """Return the runs in the file of bench/paths.py that have a track."""
    drawn = [run for row in measured["rows"] for run in row["runs"] if "track" in run]
    figure = Figure(figsize=(3.0 * len(drawn), 4.6), layout="constrained")
    above, below = figure.subplots(2, len(drawn), squeeze=False, height_ratios=(3.0, 2.0))
    for row, plane, error in zip(drawn, above, below, strict=True):
        plane.plot(*np.transpose(row["path"]), color=GREY, linewidth=4.0, label="path")
        plane.plot(*np.transpose(row["track"]), color=PATH, linewidth=1.0, label="centre")
        plane.set(aspect="equal", title=row["kind"], xlabel="x [m]")
        error.plot(row["way"], 1e3 * np.array(row["away"]), color=PATH)
        error.set(xlabel="way [m]", ylim=(0.0, None))
    above[0].set_ylabel("y [m]")
    below[0].set_ylabel("deviation [mm]")
    figure.legend(*above[0].get_legend_handles_labels(), loc="outside right")
    return figure


def worlds(measured: dict[str, Any]) -> Figure:
    """Return the paths of the first dozen runs in the file of bench/floor_worlds.py, by seed.

    Of several runs in a world the last one is blue, and those before are grey.
    """
    runs = [run for row in measured["rows"] for run in row["runs"]]
    runs.sort(key=lambda run: (run["seed"], run["kind"]))  # stable
    figure = Figure(figsize=(12.0, 9.0), layout="constrained")
    places = figure.subplots(3, 4).ravel()
    groups = [list(each) for _, each in groupby(runs, key=lambda run: (run["kind"], run["seed"]))]
    for axes, (*before, run) in zip(places, groups, strict=False):
        for other in before:
            axes.plot(*np.transpose(other["path"]), color="0.6", linewidth=1.0)
        for x0, y0, x1, y1 in run["walls"]:
            axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, color="0.35", lw=0))
        for x, y, radius in run["discs"]:
            axes.add_patch(Circle((x, y), radius, color="0.35", lw=0))
        path = np.array(run["path"])
        for place in path[:: max(1, len(path) // 60)]:
            axes.add_patch(Circle(place, ROBOT.shell_radius, color=BLUE, alpha=0.08, lw=0))
        axes.plot(*path.T, color=BLUE, linewidth=1.0)
        axes.plot(*path[0], "o", color="tab:green", markersize=4)
        axes.plot(*run["goal"][:2], "*", color=VERMILION, markersize=7)
        axes.set(xlim=(0, SIDE), ylim=(0, SIDE), aspect="equal", xticks=[], yticks=[])
        times = [f"{one['settled']:.1f} s" for one in (*before, run)]
        axes.set_title(f"{run['kind']} {run['seed']}: {', '.join(times)}")
        axes.spines[:].set_visible(True)
    for axes in places[len(groups) :]:
        axes.set_axis_off()
    return figure


OF_FILES: dict[str, Callable[[dict[str, Any]], Figure]] = {
    "integrator": integrator, "odometry": odometry, "paths": paths, "worlds": worlds,
}


def main() -> None:
    """Write the figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("figure", choices=("holding", *OF_FILES))
    parser.add_argument("measured", type=Path, nargs="?", help="file of the measurement")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--duration", type=float, default=12.0, help="of runs, for holding [s]")
    given = parser.parse_args()
    if (given.measured is None) != (given.figure == "holding"):
        parser.error("expected a file of measurements for all figures but holding")
    with styled():
        if given.measured is None:
            figure = holding(given.duration)
        else:
            figure = OF_FILES[given.figure](json.loads(given.measured.read_text()))
        dated = {"Date": None} if given.out.suffix == ".svg" else None
        figure.savefig(given.out, metadata=dated, dpi=80.0)


if __name__ == "__main__":
    main()
