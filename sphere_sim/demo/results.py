# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The demo's results: summary, figures and what is printed, from the recorded bag."""

import json
import shlex
import sys
from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console

from sphere_sim.demo.comparison import compute_other
from sphere_sim.demo.plan import DemoPlan
from sphere_sim.demo.summary import summarise, table
from sphere_sim.output.atomic_write import write_atomically
from sphere_sim.output.optional_figure import draw_or_warn
from sphere_sim.recording.errors import BagError
from sphere_sim.recording.run import Run
from sphere_sim.recording.run_reader import read_run
from sphere_sim.report.figures.comparison import side_by_side
from sphere_sim.report.figures.paper_panels import paper_panels
from sphere_sim.report.figures.style import save


def write_results(plan: DemoPlan, arrived: bool, console: Console) -> None:
    """Measure the run from its bag, compare and draw it, and print the table.

    The numbers are written before anything that takes long or may fail.

    Parameters
    ----------
    plan : DemoPlan
        What was run.
    arrived : bool
        Whether the sphere has arrived.
    console : Console
        Where to print.

    Raises
    ------
    BagError
        If the bag cannot be read or holds no goal.
    """
    run = read_run(plan.bag, name=f"{plan.strategy}, recorded over ROS")
    metrics = run.metrics()
    if metrics is None:
        raise BagError(plan.bag, "holds no goal or no pose after it")
    runs = {plan.strategy: run}
    _write_summary(plan, arrived, runs)
    drawn = [_draw(paper_panels(run, plan.title), plan.folder, "panels")]
    if plan.compare:
        other = runs[plan.other_strategy] = compute_other(plan, run)
        _write_summary(plan, arrived, runs)
        figure = side_by_side(run, other, plan.scenario_title)
        drawn.append(_draw(figure, plan.folder, "comparison"))
    console.print(table(plan, runs))
    files = ", ".join(["bag", *filter(None, drawn)])
    console.print(f"{files} and summary.json are in {plan.folder}", markup=False, soft_wrap=True)
    bag = shlex.quote(str(plan.bag))
    replay = f"to see it again: sphere_nmpc viewer --replay {bag}"
    console.print(replay, markup=False, soft_wrap=True)
    if not arrived:
        print(
            f"demo: not at the goal after {run.times[-1]:.1f} s: error {metrics.final_error:.3g}, "
            f"expected below {plan.tolerance:g}",
            file=sys.stderr,
        )


def _write_summary(plan: DemoPlan, arrived: bool, runs: dict[str, Run]) -> None:
    summary = json.dumps(summarise(plan, arrived, runs), indent=2)
    write_atomically(plan.folder / "summary.json", summary + "\n")


def _draw(figure: Figure, folder: Path, name: str) -> str:
    """Save a figure and return its file's name; empty where that is not possible."""
    saved: list[Path] = []
    draw_or_warn("demo", name, lambda: saved.extend(save(figure, folder, name)))
    return saved[0].name if saved else ""
