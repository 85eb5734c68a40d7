# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The demo's results from the recorded bag: summary, figures, comparison and what is printed."""

import dataclasses
import json
import math
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from sphere_nmpc import __version__
from sphere_nmpc.model.goal import Goal
from sphere_sim.demo.plan import DemoPlan
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.evaluation.metrics import Stay, stay_below
from sphere_sim.evaluation.series import Series
from sphere_sim.output.error_text import draw_or_warn
from sphere_sim.output.files import write_atomically
from sphere_sim.output.round_numbers import length
from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.message_fields import ReportedSolve
from sphere_sim.recording.run import Run, without_sign_jumps
from sphere_sim.recording.run_reader import read_run
from sphere_sim.report.figures.comparison import side_by_side
from sphere_sim.report.figures.paper import paper_panels
from sphere_sim.report.figures.style import save
from sphere_sim.study.single_run import assemble

_AT_LEAST = 20.0
"""Shortest duration of the other run [s]: the paper's cases need up to 13."""
_MANY_MISSED = 0.01
"""Share of missed sampling instants from which on it is reported."""
_ROWS: tuple[tuple[str, str, Callable[[float], str]], ...] = (
    ("final error", "final_error", "{:.2e}".format),
    ("final distance", "final_position_error_m", length),
    ("final angle", "final_orientation_error_rad", lambda angle: f"{math.degrees(angle):.3f} deg"),
    ("largest rotor speed", "max_rotor_speed", "{:.1f} rad/s".format),
    ("largest rotor torque", "max_rotor_torque_nm", "{:.2f} N m".format),
    ("solve time, median", "solve_ms_p50", "{:.2f} ms".format),
    ("solve time, p99", "solve_ms_p99", "{:.2f} ms".format),
)
"""Title and figure of the rows of the table, and the text of a value."""


def hints_of(plan: DemoPlan, missed: float, reported: str, duration: float) -> str:
    """Return what may keep the sphere from its goal, with remedies; empty if nothing is known.

    These are the sampling instants of `duration` [s] that the controller has missed, and what it
    has reported last.
    """
    period = plan.conditions.controller.control_period
    share = missed * period / max(period, duration)
    hints = [f"{100.0 * share:.0f} % of the sampling instants missed: --rtf 0 lets time wait for "
             "the controller"] if share >= _MANY_MISSED else []
    return "; ".join([*hints, *filter(None, [reported])])


def write_results(plan: DemoPlan, arrived: bool, console: Console, hints: str = "") -> None:
    """Measure the run from its bag, compare and draw it, and print the table.

    Where the sphere has not arrived, a line has the `hints` why.

    The numbers are written before anything that takes long or may fail, as reading the bag may.
    """
    run = read_run(plan.bag, name=f"{plan.strategy}, recorded over ROS")
    figures = {plan.strategy: _figures(run, plan)}
    _write_summary(plan, arrived, run, figures)
    drawn = [_draw(paper_panels(run, plan.title), plan.folder, "panels")]
    if plan.compare:
        other = _computed_other(plan, run)
        figures[plan.other_strategy] = _figures(other, plan)
        _write_summary(plan, arrived, run, figures)
        figure = side_by_side(run, other, plan.scenario_title)
        drawn.append(_draw(figure, plan.folder, "comparison"))
    console.print(_table(plan, figures))
    files = ", ".join(["bag", *filter(None, drawn)])
    console.print(f"{files} and summary.json are in {plan.folder}", markup=False, soft_wrap=True)
    bag = shlex.quote(str(plan.bag))
    replay = f"to see it again: sphere_nmpc viewer --replay {bag}"
    console.print(replay, markup=False, soft_wrap=True)
    if not arrived:
        error = figures[plan.strategy]["final_error"]
        print(
            f"demo: not at the goal after {run.times[-1]:.1f} s: error {error:.3g}, "
            f"expected below {plan.tolerance:g} for a sample period"
            + (f"; {hints}" if hints else ""),
            file=sys.stderr,
        )


def _figures(run: Run, plan: DemoPlan) -> dict[str, float]:
    """Return the metrics of a run, and when and how well it stayed within the plan's tolerance."""
    metrics = run.metrics()
    if metrics is None:
        raise BagError(run.path, "holds no goal or no pose after it")
    stay = stay_below(run.times, run.goal_errors[:, 0], plan.tolerance)
    stay = stay or Stay(math.nan, math.nan, math.nan)
    return dataclasses.asdict(metrics) | {
        "within_s": stay.since, "max_error_after": stay.largest, "p95_error_after": stay.p95
    }


def _write_summary(
    plan: DemoPlan, arrived: bool, run: Run, figures: dict[str, dict[str, float]]
) -> None:
    """Write ``summary.json`` with the figures of the recorded run and of the computed one."""
    plain = {
        # JSON lacks nan and infinity.
        strategy: {k: v if math.isfinite(v) else None for k, v in values.items()}
        for strategy, values in figures.items()
    }
    content = {
        "title": plan.title, "sphere_nmpc_version": __version__, "strategy": plan.strategy,
        "arrived": arrived, "tolerance": plan.tolerance,
        "start": plan.scenario.start.tolist(), "goal": plan.scenario.goal.tolist(),
        "seed": plan.scenario.seed, "simulator": plan.simulator, "controller": plan.controller,
        "metrics": plain.pop(plan.strategy), "compared_with": plain,
        "duration_s": float(run.times[-1]), "notes": list(run.notes),
    }
    write_atomically(plan.folder / "summary.json", json.dumps(content, indent=2) + "\n")


def _draw(figure: Figure, folder: Path, name: str) -> str:
    """Save a figure and return its file's name; empty where that is not possible."""
    saved: list[Path] = []
    draw_or_warn("demo", name, lambda: saved.extend(save(figure, folder, name)))
    return saved[0].name if saved else ""


def _table(plan: DemoPlan, figures: dict[str, dict[str, float]]) -> Table:
    """Return a table with one column for each strategy."""
    how = {plan.strategy: "recorded over ROS", plan.other_strategy: "computed without ROS"}
    made = Table("result", *(f"{name}\n{how[name]}" for name in figures))
    # Under noise the error does not settle below 1e-2, but it stays in a neighbourhood.
    seconds, plain = "{:.2f} s".format, "{:.3f}".format
    settled = [("settling time (error < 1e-2)", "settle_time_s", seconds)]
    if plan.disturbed:
        settled = [
            (f"error < {plan.tolerance:g} from", "within_s", seconds),
            ("95th percentile from then on", "p95_error_after", plain),
            ("largest error from then on", "max_error_after", plain),
        ]
    for title, name, text in (*settled, *_ROWS):
        none = "not settled" if name in ("within_s", "settle_time_s") else "-"
        values = [of_strategy[name] for of_strategy in figures.values()]
        made.add_row(title, *(none if math.isnan(value) else text(value) for value in values))
    return made


def _computed_other(plan: DemoPlan, recorded: Run) -> Run:
    """Run the other strategy without ROS, on the same plant and seed, at least as long."""
    conditions = plan.conditions.with_settings([("controller.strategy", plan.other_strategy)])
    trajectory = run_closed_loop(
        *assemble(conditions, plan.scenario, plan.robot), plan.scenario.goal,
        max(_AT_LEAST, float(np.ceil(recorded.times[-1]))),
    )
    tracked = [decision.plan for decision in trajectory.decisions if decision.solved]
    goal = Series(np.zeros(1), (Goal(plan.scenario.goal),), lasting=True)
    poses = trajectory.poses
    solves = (
        (it.hold.start, ReportedSolve(
            it.made.solve_time, it.made.cost, it.arrival - it.hold.start, it.status.value
        )) for it in tracked
    )
    return Run(
        dataclasses.replace(poses, values=without_sign_jumps(poses.values)),
        trajectory.rotor_speeds, trajectory.rotor_torques,
        f"{plan.other_strategy}, computed without ROS", Path(), goal,
        Series.of((hold.start, hold) for hold in trajectory.holds), Series.of(solves),
    )
