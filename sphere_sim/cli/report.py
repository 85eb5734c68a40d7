# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc report``: figures, a page and tables from recorded runs."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from sphere_nmpc.errors import printable_line
from sphere_sim.output.files import prepare_folder, printable
from sphere_sim.recording.bag_files import storage_name
from sphere_sim.recording.run_reader import read_run
from sphere_sim.report.page import results
from sphere_sim.report.report_files import write_report
from sphere_sim.report.reported import Reported, select_goals

_ALL = "all"


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the report; return 0, also for a run without a goal, whose report has no metrics."""
    given = _parse(arguments)
    prepare_folder(given.out)
    names = _names(given.bags)
    wanted = None if _ALL in given.goal else given.goal
    reported = []
    for path, name in zip(given.bags, names, strict=True):
        recording = read_run(path, given.namespace, name, given.pose_topic)
        # The files of a single bag have the plain names that scripts and documents rely on.
        prefix = f"{name}_" if len(names) > 1 else ""
        reported.append(Reported(recording, select_goals(recording, wanted), prefix))
    # Printed first, so that the results are known even if the report cannot be written.
    for one in reported:
        _print_results(one)
    page = write_report(reported, given.out, csv=given.csv, animation=given.animation)
    print(f"report in {printable(page)}")
    return 0


def _print_results(one: Reported) -> None:
    recording = one.recording
    for note in recording.notes:
        print(printable_line(f"report: {recording.name}: {note}"), file=sys.stderr)
    for run in one.runs.values():
        for name, value in results(run):
            print(f"{run.name}: {name} {value}")
    if one.hint:
        print(f"{recording.name}: {one.hint}")
    if not one.goals:
        print(f"{recording.name}: no metrics, as no goal was in force at any pose; see the notes")


def _goal(text: str) -> int | str:
    if text == _ALL or (text.isdecimal() and int(text) > 0):
        return _ALL if text == _ALL else int(text)
    raise argparse.ArgumentTypeError(f"given {text!r}, expected a number from 1 on, or all")


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
    parser.add_argument("--pose-topic", metavar="TOPIC",
                        help="topic of the robot's poses, if a bag does not say which it is")
    parser.add_argument("--goal", nargs="+", type=_goal, default=[], metavar="N",
                        help="goals, from 1 on in the order of the recording, whose figures are "
                        "drawn, or 'all' (default: the last)")
    parser.add_argument("--animation", action="store_true",
                        help="also write an animation (GIF) of each run")
    parser.add_argument("--csv", action="store_true", help="also write the tables as CSV")
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
