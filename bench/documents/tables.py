# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of documents: declared runs, made in several processes, and printed row by row."""

import argparse
import multiprocessing
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

sys.path.append(str(Path(__file__).parents[1]))

import numpy as np
from machine import machine, write_json
from rich.console import Console
from rich.progress import track

from sphere_nmpc.model.state import Vector
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_sim.output.arguments import assignment
from sphere_sim.scenario.perturbation import DisturbanceDraws
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import floor_of

UNDISTURBED = DisturbanceDraws()


def conditions_of(settings: str, duration: float, percent: float = 0.0) -> StudyConditions:
    """Return conditions with settings as of ``study --set``, separated by spaces."""
    conditions = StudyConditions(duration, percent)
    return conditions.with_settings(assignment(each) for each in settings.split())


def drawn(
    conditions: StudyConditions, number: int, seed: int, kind: str = "anywhere",
    draws: DisturbanceDraws = UNDISTURBED,
) -> list[Scenario]:
    """Return random scenarios on the floor of the conditions, with disturbances."""
    floor, _ = floor_of(conditions.floor, conditions.robot.shell_radius)
    scenarios = draw_scenarios(number, seed, kind, floor)
    return [draws.applied_to(scenario) for scenario in scenarios]


class Row(NamedTuple):
    """First cells of a row, and the arguments of each of its runs."""

    names: tuple[object, ...]
    runs: Sequence[tuple[Any, ...]]

    @classmethod
    def of(
        cls, names: tuple[object, ...], settings: str, duration: float,
        scenarios: Iterable[Scenario], percent: float = 0.0,
    ) -> "Row":
        """Return a row whose runs have the same conditions."""
        conditions = conditions_of(settings, duration, percent)
        return cls(names, [(conditions, scenario) for scenario in scenarios])


class Table(NamedTuple):
    """A table of runs.

    `rows` returns the rows for a number of runs and a seed, `run` makes one and returns what is
    judged, and `cells` returns the further cells of a row from what its runs have returned, and
    those of the first row.
    """

    columns: tuple[str, ...]
    rows: Callable[[int, int], Iterable[Row]]
    run: Callable[..., Any]
    cells: Callable[[list[Any], list[Any]], Iterable[object]]
    number: int = 1
    """Number of runs of a row, or of seeds of each case, where none is given."""
    seed: int = 1
    has_reference: bool = False
    """Whether the first row is made in any case, as others are compared with it."""
    has_total: bool = False
    """Whether a row of all runs follows."""

    def made(
        self, number: int | None = None, seed: int | None = None, jobs: int | None = None,
        only: Sequence[str] = (), changed: Callable[[Any], Any] = lambda argument: argument,
    ) -> Iterator[tuple[Row, list[Any]]]:
        """Yield each row with what its runs have returned, as soon as they are made.

        `changed` is applied to the arguments of each run. `only` are first names of rows; none
        are all.
        """
        rows = list(self.rows(number or self.number, self.seed if seed is None else seed))
        known = dict.fromkeys(str(one.names[0]) for one in rows)
        if unknown := [name for name in only if name not in known]:
            raise SystemExit(f"--only: given {unknown[0]!r}, expected one of {', '.join(known)}")
        first = rows[0] if self.has_reference else None
        rows = [one for one in rows if not only or str(one.names[0]) in only or one is first]
        tasks = [tuple(map(changed, run)) for row in rows for run in row.runs]
        results = in_processes(self.run, tasks, jobs)
        for row in rows:
            yield row, [next(results) for _ in row.runs]

    def printed(self, *options: Any, **named: Any) -> list[tuple[Row, list[Any]]]:
        """Print the table, a row as soon as it is made, and return what `made` yields."""
        print(header(*self.columns), flush=True)
        made: list[tuple[Row, list[Any]]] = []
        for line, found in self.made(*options, **named):
            made.append((line, found))
            print(row(*line.names, *self.cells(found, made[0][1])), flush=True)
        if self.has_total:
            found = [run for _, runs in made for run in runs]
            print(row("all", len(found), *self.cells(found, found)))
        return made


def print_tables(tables: Mapping[str, Table], about: str | None) -> None:
    """Print the table that the command line names, and write its results."""
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if len(tables) > 1:
        parser.add_argument("table", choices=tables)
    parser.add_argument("--runs", type=int, help="of a row; of each case, for those of the paper")
    parser.add_argument("--seed", type=int, help="of what is drawn")
    parser.add_argument("--only", nargs="+", default=[], help="rows, by their first cells")
    parser.add_argument("--duration", type=float, help="of each run [s], where it is free")
    parser.add_argument("--perturb", type=float, help="as of study, in all runs [%%]")
    parser.add_argument("--set", type=assignment, nargs="+", default=[], metavar="NAME=VALUE",
                        help="as of study, in all runs")
    parser.add_argument("--jobs", type=int, help="processes; all cores by default")
    parser.add_argument("--json", type=Path, help="file for the results of all runs")
    given = parser.parse_args()
    limit_library_threads()

    def changed(argument: Any) -> Any:
        if not isinstance(argument, StudyConditions):
            return argument
        conditions = argument.with_settings(given.set)
        whole = {"duration": given.duration, "perturbation": given.perturb}
        return replace(conditions, **{k: v for k, v in whole.items() if v is not None})

    table = tables[given.table] if len(tables) > 1 else next(iter(tables.values()))
    made = table.printed(given.runs, given.seed, given.jobs, given.only, changed)
    rows = [{"names": line.names, "runs": found} for line, found in made]
    write_json(given.json, {"machine": machine(), "rows": rows})


def row(*cells: object) -> str:
    """Return a row of a Markdown table."""
    return f"| {' | '.join(map(str, cells))} |"


def header(*cells: str) -> str:
    """Return the first two lines of a Markdown table."""
    return f"{row(*cells)}\n{'|---' * len(cells)}|"


def median_and_worst(values: Sequence[float] | Vector, how: str) -> str:
    """Return the median and, in brackets, the largest value; a dash where there is none."""
    known = np.asarray(values, dtype=float)
    return f"{np.median(known):{how}} ({known.max():{how}})" if known.size else "-"


def in_processes(
    call: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], jobs: int | None = None
) -> Iterator[Any]:
    """Yield the results of calls with the arguments of each task, made in new processes.

    They are no copies of this one, whose libraries (DDS, an engine, a browser) may be half way
    through something in another thread.
    """
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        results = pool.map(call, *zip(*tasks, strict=True))
        console = Console(stderr=True)
        yield from track(results, "runs", len(tasks), transient=True, console=console)
