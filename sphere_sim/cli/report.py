# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc report``: figures, a page and tables from recorded runs."""

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from sphere_sim.output.atomic_write import write_atomically
from sphere_sim.output.printable_path import printable
from sphere_sim.output.result_folder import prepare_folder
from sphere_sim.recording.bag_files import storage_name
from sphere_sim.recording.run import Run
from sphere_sim.recording.run_reader import read_run
from sphere_sim.report.figures import analysis
from sphere_sim.report.figures.animation import write_animation
from sphere_sim.report.figures.comparison import comparison
from sphere_sim.report.figures.contact_locus import contact_locus
from sphere_sim.report.figures.paper_panels import paper_panels
from sphere_sim.report.figures.style import save
from sphere_sim.report.page import describe, write_page
from sphere_sim.report.series import motion_table, solve_table, write_csv, write_parquet

FIGURES: dict[str, tuple[Callable[[Run], Figure], str]] = {
    "panels": (
        paper_panels,
        "Position, Euler parameters, path and rotor speeds; dotted: the goal and the limits.",
    ),
    "error": (analysis.error_over_time, "Error in the norm of the state, distance and angle."),
    "contact": (
        contact_locus,
        "Where the shell touched the ground; the locus crosses circle Γ at a right angle.",
    ),
    "torque": (analysis.rotor_torques, "Torques of the rotors' motors."),
    "solve_time": (analysis.solve_times, "What the solves took, over time and as a histogram."),
    "value": (analysis.value_function, "Value of the optimal control problem at each sample."),
}
"""What is drawn of each run: file name, how, and the words below."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the report.

    Returns
    -------
    int
        0 when it is written. A run without a goal has a report too, which says that it has no
        figures.

    Raises
    ------
    BagError
        If a bag cannot be read.
    PlaceError, OSError
        If the report cannot be written.
    """
    given = _parse(arguments)
    prepare_folder(given.out)
    names = _names(given.bags)
    runs = [
        read_run(path, given.namespace, name) for path, name in zip(given.bags, names, strict=True)
    ]
    for run in runs:
        _tell(run)
    # With one run the files have the plain names that scripts and documents rely on.
    prefixes = [f"{name}_" for name in names] if len(runs) > 1 else [""]
    print(f"report in {printable(_write(runs, prefixes, given))}")
    return 0


def _tell(run: Run) -> None:
    """Print the results, which nothing that cannot be written takes away."""
    for note in run.notes:
        print(f"report: {run.name}: {note}", file=sys.stderr)
    metrics = run.metrics()
    for name, value in describe(metrics):
        print(f"{run.name}: {name} {value}")
    if metrics is None:
        print(f"{run.name}: no figures, as no goal was in force at any pose; see the notes")


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="sphere_nmpc report",
        description="Turn bags, of the recorder or of 'ros2 bag record', into figures (PNG and "
        "SVG), a self-contained HTML page and, if asked for, tables.",
    )
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG",
                        help="folder of a bag, or a .mcap or .db3 file, also with .zstd behind")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where to write")
    parser.add_argument("--namespace", metavar="NS", help="which robot, if a bag has several")
    parser.add_argument("--animation", action="store_true",
                        help="write an animated picture (GIF) of each run too")
    parser.add_argument("--csv", action="store_true", help="write the series as CSV too")
    parser.add_argument("--parquet", action="store_true", help="write the series as Parquet too")
    return parser.parse_args(arguments)


def _names(bags: Sequence[Path]) -> list[str]:
    """Return a short name for each bag, all different; the demo calls every bag 'bag'."""
    resolved = [bag.resolve() for bag in bags]
    names = [bag.parent.name if bag.name == "bag" else Path(storage_name(bag)).stem
             for bag in resolved]
    return [
        name if names.count(name) == 1 else f"{name}_{names[: i + 1].count(name)}"
        for i, name in enumerate(names)
    ]


def _write(runs: Sequence[Run], prefixes: Sequence[str], given: argparse.Namespace) -> Path:
    """Write numbers before pictures, and what is largest and least needed last."""
    out: Path = given.out
    summary = {run.name: _summary(run) for run in runs}
    write_atomically(out / "summary.json", json.dumps(summary, indent=2) + "\n")
    for run, prefix in zip(runs, prefixes, strict=True):
        _write_tables(run, given, prefix)
    figures: list[tuple[str, str, Path]] = []
    if len(runs) > 1:
        words = "Errors, paths, rotor speeds and solve times of all runs."
        figures.append(("Comparison", words, save(comparison(runs), out, "comparison")[1]))
    for run, prefix in zip(runs, prefixes, strict=True):
        for name, (draw, words) in FIGURES.items():
            files = save(draw(run), out, f"{prefix}{name}")
            figures.append((run.name, words, files[1]))
    page = out / "report.html"
    write_page(page, runs, figures)
    if given.animation:
        for run, prefix in zip(runs, prefixes, strict=True):
            write_animation(run, out / f"{prefix}animation.gif")
    return page


def _write_tables(run: Run, given: argparse.Namespace, prefix: str) -> None:
    for name, table in (("motion", motion_table(run)), ("solves", solve_table(run))):
        if given.csv:
            write_csv(table, given.out / f"{prefix}{name}.csv")
        if given.parquet:
            write_parquet(table, given.out / f"{prefix}{name}.parquet")


def _summary(run: Run) -> dict[str, object]:
    metrics = run.metrics()
    values = {} if metrics is None else dataclasses.asdict(metrics)
    # JSON has no nan, the one number that differs from itself.
    finite = {key: value if value == value else None for key, value in values.items()}
    return {"bag": printable(run.path), "metrics": finite, "notes": list(run.notes)}
