# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc benchmark``: the solver against other solvers, on this machine."""

import argparse
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sphere_nmpc.process.library_threads import ONE_EACH
from sphere_sim.output.arguments import not_negative, positive, whole
from sphere_sim.output.error_text import draw_or_warn
from sphere_sim.output.files import prepare_folder, write_atomically

_FILE_WIDTH = 160
"""Columns of a table that is not printed on a terminal."""

_LONGEST = 1e5
"""Longest run [s], as in studies."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmark; return 0 unless a solver of the package cannot be set up.

    Numbers are written first. A figure that cannot be drawn is a warning.
    """
    options = _parse(argv)
    prepare_folder(options.json.parent)
    # Before numpy is loaded: its libraries read them once.
    os.environ.update(ONE_EACH)
    from rich.console import Console

    from sphere_sim.benchmark.report import draw, show
    from sphere_sim.benchmark.solvers import OWN

    console = Console()
    if not console.is_terminal:
        console = Console(width=_FILE_WIDTH)
    records, missing, report = _run(options, console)
    write_atomically(options.json, json.dumps(report, indent=2) + "\n")
    show(report, options.cases, console)
    written, figure = str(options.json), options.json.with_suffix(".png")
    if draw_or_warn("benchmark", str(figure), lambda: draw(records, figure)):
        written += f" and {figure}"
    console.print(f"Written: {written}", markup=False)
    return 1 if any(name in missing for name in OWN) else 0


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="sphere_nmpc benchmark", description=__doc__)
    parser.add_argument("--json", type=Path, required=True, help="file of the numbers")
    parser.add_argument("--quick", action="store_true", help="fewer solvers, one round, no extras")
    parser.add_argument("--rounds", type=whole(1), default=3,
                        help="how often the cases are run (default: 3)")
    parser.add_argument("--budget", type=not_negative, default=60.0,
                        help="seconds that a solver may spend in all its solves, then its other "
                        "runs are left out (default: 60)")
    parser.add_argument("--random", type=whole(0), default=0, metavar="N",
                        help="also compare the costs of N random problems with IPOPT's")
    parser.add_argument("--cases", type=int, nargs="+", default=[1, 2, 3, 4],
                        choices=[1, 2, 3, 4], help="which of the paper's cases (default: all)")
    parser.add_argument("--duration", type=positive, default=30.0,
                        help="simulated seconds (default: 30)")
    parser.add_argument("--acados-python", metavar="PATH",
                        help="Python of an environment with acados, which is then benchmarked too")
    options = parser.parse_args(argv)
    if options.quick:
        options.rounds, options.budget = 1, min(options.budget, 15.0)
    if not 1.0 <= options.duration <= _LONGEST:
        parser.error(f"--duration: given {options.duration:g}, expected 1 to {_LONGEST:g} s")
    if options.json.suffix == ".png" or options.json.is_dir():
        # The figure has the same name with the suffix .png.
        parser.error(f"--json: given {options.json}, expected the name of a file, not a .png")
    return options


def _run(options: argparse.Namespace, console: Any) -> tuple[Any, dict[str, str], dict[str, Any]]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from sphere_sim.benchmark.acados import acados_makers
    from sphere_sim.benchmark.closed_loops import run_closed_loops, set_up
    from sphere_sim.benchmark.nlp_solvers import ipopt
    from sphere_sim.benchmark.problem import SAMPLE_PERIOD
    from sphere_sim.benchmark.random_problems import Comparison
    from sphere_sim.benchmark.report import as_numbers
    from sphere_sim.benchmark.solvers import ALL, IPOPT, QUICK
    from sphere_sim.scenario.scenarios import PAPER_CASES

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        makers = QUICK if options.quick else ALL
        if options.acados_python or not options.quick:
            makers = {**makers, **acados_makers(options.acados_python)}
        task = progress.add_task("setting up", total=len(makers))

        def show_set_up(name: str) -> None:
            progress.update(task, description=f"setting up {name}", advance=1)

        records, missing = set_up(makers, show_set_up)
        samples = round(options.duration / SAMPLE_PERIOD)
        total = options.rounds * len(options.cases) * samples * len(records)
        task = progress.add_task("closed loops", total=total)
        scenarios = [PAPER_CASES[case] for case in options.cases]
        for _ in run_closed_loops(records, scenarios, samples, options.rounds, options.budget):
            progress.advance(task)
        report = as_numbers(records, missing)
        if options.random:
            comparison = Comparison()
            task = progress.add_task(f"random problems ({IPOPT})", total=options.random)
            for _ in comparison.run(ipopt(), options.random, 0):
                progress.advance(task)
            report["random"] = comparison.summary()
    return records, missing, report
