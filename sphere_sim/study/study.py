# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A study: many scenarios, one strategy or several, one folder of results."""

import contextlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sphere_sim.output.optional_figure import draw_or_warn
from sphere_sim.output.result_folder import ResultFolderError
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.figure import FIGURES, draw
from sphere_sim.study.fingerprint import fingerprint
from sphere_sim.study.journal import NAME as JOURNAL
from sphere_sim.study.journal import Journal
from sphere_sim.study.record import RunRecord, Value
from sphere_sim.study.single_run import prepare, run_scenario
from sphere_sim.study.summary import summarise
from sphere_sim.study.tables import replace_file, write_inputs, write_runs
from sphere_sim.study.workers import Workers

Bounds = Callable[[Sequence[Scenario]], Sequence[float]]
"""Best known time [s] of each scenario."""

Watch = Callable[[RunRecord], None]
"""Told of each run, those recorded earlier included."""


@dataclass(frozen=True)
class Study:
    """What to run and where to keep it.

    Attributes
    ----------
    scenarios : sequence of Scenario
        At least one.
    conditions : StudyConditions
        What all runs share; its strategy is the first one.
    folder : Path
        Where the results go; of several strategies each has a folder of its name in there.
    strategies : tuple of str
        Strategies to compare; empty for the one of `conditions`.
    """

    scenarios: Sequence[Scenario]
    conditions: StudyConditions
    folder: Path
    strategies: tuple[str, ...] = ()

    def run(
        self, workers: Workers, bounds: Bounds | None = None, watch: Watch | None = None
    ) -> dict[str, dict[str, Any]]:
        """Make the runs that are not recorded yet and write all results.

        Tables are written as soon as all runs are made, and again with the best known times when
        these are found. A figure that cannot be drawn is told and left out.

        Parameters
        ----------
        workers : Workers
            Where the runs are made.
        bounds : callable, optional
            Gives the best known times.
        watch : callable, optional
            Is told of each run.

        Returns
        -------
        dict of str to dict
            The summary of each strategy.

        Raises
        ------
        SphereNmpcError
            If the folder cannot take the results, or the runs cannot be made.
        """
        names = self.strategies or (self.conditions.controller.strategy,)
        folders = {name: self.folder / name if len(names) > 1 else self.folder for name in names}
        if len(names) > 1:
            self._refuse_other_results(folders.values())
        with contextlib.ExitStack() as exits:
            journals = {}
            for name, folder in folders.items():
                conditions = self._with(name)
                # What no run could do without is missed here, not once a run.
                prepare(conditions, self.scenarios[0])
                journal = Journal(folder, fingerprint(conditions, self.scenarios))
                journals[name] = exits.enter_context(journal)
            records = {
                name: self._records(self._with(name), journal, workers, watch)
                for name, journal in journals.items()
            }
            # First of all what is known: the search may take long, and be stopped.
            summaries, tables = self._write(folders, records, None)
            for name, folder in folders.items():
                write_inputs(folder / "inputs.npz", records[name])
            if bounds is not None:
                summaries, tables = self._write(folders, records, bounds(self.scenarios))
            for folder, results in tables.items():
                self._draw(folder, results, summaries)
        return summaries

    def _with(self, strategy: str) -> StudyConditions:
        controller = replace(self.conditions.controller, strategy=strategy)
        return replace(self.conditions, controller=controller)

    def _records(
        self,
        conditions: StudyConditions,
        journal: Journal,
        workers: Workers,
        watch: Watch | None,
    ) -> list[RunRecord]:
        if watch is not None:
            for record in journal.records.values():
                watch(record)
        tasks = [
            (index, (conditions, scenario))
            for index, scenario in enumerate(self.scenarios)
            if index not in journal.records
        ]
        for index, record in workers.run(run_scenario, tasks, "run"):
            journal.append(index, record)
            if watch is not None:
                watch(record)
        return [journal.records[i] for i in range(len(self.scenarios))]

    def _refuse_other_results(self, folders: Iterable[Path]) -> None:
        ours = any((folder / JOURNAL).exists() for folder in folders)
        alone = (self.folder / JOURNAL).exists()
        if alone or (not ours and (self.folder / "runs.csv").exists()):
            raise ResultFolderError(
                self.folder, "holds results of something else; choose another folder"
            )

    def _write(
        self,
        folders: Mapping[str, Path],
        records: Mapping[str, Sequence[RunRecord]],
        times: Sequence[float] | None,
    ) -> tuple[dict[str, dict[str, Any]], dict[Path, dict[str, list[dict[str, Value]]]]]:
        """Write all tables; return the summary of each strategy and the results by folder."""
        results = {name: _compared(found, times) for name, found in records.items()}
        summaries = {name: summarise(self.scenarios, found) for name, found in results.items()}
        tables = {folder: {name: results[name]} for name, folder in folders.items()}
        tables[self.folder] = results
        for folder, table in tables.items():
            write_runs(folder / "runs.csv", self.scenarios, table.values())
            told = {name: summaries[name] for name in table}
            content = {"strategies": told} if len(told) > 1 else next(iter(told.values()))
            text = json.dumps(content, indent=1, allow_nan=False) + "\n"
            replace_file(folder / "summary.json", text.encode())
        return summaries, tables

    def _draw(
        self,
        folder: Path,
        results: Mapping[str, Sequence[dict[str, Value]]],
        summaries: Mapping[str, dict[str, Any]],
    ) -> None:
        """Draw the figure of a folder, which nothing depends on."""
        about = describe(self.conditions, len(self.scenarios))
        shown = {name: summaries[name] for name in results}
        files = " and ".join(str(folder / name) for name in FIGURES)
        draw_or_warn("study", files, lambda: draw(folder, results, shown, about))


def describe(conditions: StudyConditions, runs: int) -> str:
    """Return in words what a study was made under."""
    simulator = conditions.simulator
    return (
        f"{runs} scenarios of {conditions.duration:g} s, plant {simulator.plant}, parameters "
        f"+-{conditions.perturbation:g} %, process noise {simulator.process_noise:g} a sample,\n"
        f"pose noise {simulator.position_noise:g} m and {simulator.orientation_noise:g} rad, "
        f"latency {conditions.latency:g} s"
    )


def _compared(
    records: Sequence[RunRecord], times: Sequence[float] | None
) -> list[dict[str, Value]]:
    """Return the results with the bound and the ratio to it, where they are known."""
    compared = []
    for i, record in enumerate(records):
        results = dict(record.results)
        bound = None if times is None else float(times[i])
        # A bound that is nan is not known; at a goal that is the start there is none.
        if bound is not None and bound > 0.0:
            settling = results.get("settle_time_s")
            results["bound_s"] = bound
            if isinstance(settling, float):
                results["ratio"] = settling / bound
        compared.append(results)
    return compared
