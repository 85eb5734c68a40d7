# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc report``: figures, a page and tables from recorded runs."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from sphere_nmpc.foreign_text import printable_line
from sphere_sim.output.printable_path import printable
from sphere_sim.output.result_folder import prepare_folder
from sphere_sim.recording.bag_files import storage_name
from sphere_sim.recording.run import Run
from sphere_sim.recording.run_reader import read_run
from sphere_sim.report.page import results
from sphere_sim.report.report_files import write_report


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the report.

    Returns
    -------
    int
        0 when it is written, also for a run without a goal, whose report has no metrics.

    Raises
    ------
    BagError
        If a bag cannot be read.
    ResultFolderError, OSError
        If the report cannot be written.
    """
    given = _parse(arguments)
    prepare_folder(given.out)
    names = _names(given.bags)
    runs = [
        read_run(path, given.namespace, name) for path, name in zip(given.bags, names, strict=True)
    ]
    # Printed first, so that the results are known even if the report cannot be written.
    for run in runs:
        _print_results(run)
    # The files of a single run have the plain names that scripts and documents rely on.
    prefixes = [f"{name}_" for name in names] if len(runs) > 1 else [""]
    page = write_report(
        runs, prefixes, given.out, csv=given.csv, parquet=given.parquet, animation=given.animation
    )
    print(f"report in {printable(page)}")
    return 0


def _print_results(run: Run) -> None:
    for note in run.notes:
        print(printable_line(f"report: {run.name}: {note}"), file=sys.stderr)
    for name, value in results(run):
        print(f"{run.name}: {name} {value}")
    if run.metrics() is None:
        print(f"{run.name}: no metrics, as no goal was in force at any pose; see the notes")


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="sphere_nmpc report",
        description="Turn bags, of the recorder or of 'ros2 bag record', into figures (PNG and "
        "SVG), a self-contained HTML page and optional tables.",
    )
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG",
                        help="folder of a bag, or a .mcap or .db3 file, also with suffix .zstd")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR",
                        help="folder of the report")
    parser.add_argument("--namespace", metavar="NS",
                        help="namespace of the robot, if a bag has several")
    parser.add_argument("--animation", action="store_true",
                        help="also write an animation (GIF) of each run")
    parser.add_argument("--csv", action="store_true", help="also write the tables as CSV")
    parser.add_argument("--parquet", action="store_true", help="also write the tables as Parquet")
    return parser.parse_args(arguments)


def _names(bags: Sequence[Path]) -> list[str]:
    """Return a short, unique name of each bag; for a folder 'bag', that of the folder above."""
    resolved = [bag.resolve() for bag in bags]
    names = [bag.parent.name if bag.name == "bag" else Path(storage_name(bag)).stem
             for bag in resolved]
    return [
        name if names.count(name) == 1 else f"{name}_{names[: i + 1].count(name)}"
        for i, name in enumerate(names)
    ]
