# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Study: closed loops of many scenarios with one or several strategies, and their results."""

import contextlib
import json
import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any

from sphere_sim.output.error_text import draw_or_warn
from sphere_sim.output.files import ResultFolderError
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.figure import FIGURES, describe, draw
from sphere_sim.study.journal import NAME as JOURNAL
from sphere_sim.study.journal import Journal, fingerprint
from sphere_sim.study.motion import Motion, motion_of
from sphere_sim.study.record import RunRecord, Value
from sphere_sim.study.single_run import prepare, run_scenario
from sphere_sim.study.tables import replace_file, summarise, with_bounds, write_inputs, write_runs
from sphere_sim.study.workers import Workers

_log = logging.getLogger("sphere_nmpc")

BestKnown = Callable[[Sequence[Motion]], Sequence[float]]
"""Returns the settling time of the best known motion for each motion [s]."""

Observer = Callable[[RunRecord], None]
"""Called with each run, those recorded earlier included."""


@dataclass(frozen=True)
class Study:
    """Scenarios, conditions and folder of a study.

    Attributes
    ----------
    scenarios : sequence of Scenario
        Start and goal of each run, at least one.
    conditions : StudyConditions
        Settings that all runs share; their strategy is the first one.
    folder : Path
        Folder of the results; each of several strategies has a subfolder of its name.
    strategies : tuple of str
        Names of the strategies to compare; empty for that of `conditions`.
    """

    scenarios: Sequence[Scenario]
    conditions: StudyConditions
    folder: Path
    strategies: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "folder", Path(self.folder))

    def run(
        self, workers: Workers | int = 1, best_known: BestKnown | None = None,
        observer: Observer | None = None,
    ) -> dict[str, dict[str, Any]]:
        """Make the runs that are not recorded yet and write all results.

        `workers` is also the number of processes; with 1 none is started. Tables are written as
        soon as all runs are made, and again with the best known times when these are found. A
        figure that cannot be drawn is a warning.

        Returns the summary of each strategy.
        """
        contradiction = self.conditions.of_plant.contradiction(self.conditions.robot)
        if contradiction is not None:
            _log.warning("sphere_nmpc study: %s", contradiction)
        names = self.strategies or (self.conditions.controller.strategy,)
        folders = {name: self.folder / name if len(names) > 1 else self.folder for name in names}
        if len(names) > 1:
            self._refuse_other_results(folders.values())
        with contextlib.ExitStack() as exits:
            if isinstance(workers, int):
                workers = exits.enter_context(Workers(workers))
            journals = {}
            for name, folder in folders.items():
                conditions = self._with(name)
                # Missing packages and invalid settings are an error here, not of each run.
                prepare(conditions, self.scenarios[0])
                journal = Journal(folder, fingerprint(conditions, self.scenarios))
                journals[name] = exits.enter_context(journal)
            records = {
                name: self._records(self._with(name), journal, workers, observer)
                for name, journal in journals.items()
            }
            robot, disturbances = self.conditions.robot, self.conditions.disturbances
            motions = {
                name: [motion_of(scenario, record, robot, disturbances)
                       for scenario, record in zip(self.scenarios, found, strict=True)]
                for name, found in records.items()
            }
            # The search for best known times may take long and be interrupted.
            summaries, tables = self._write(folders, records, motions, {})
            for name, folder in folders.items():
                write_inputs(folder / "inputs.npz", records[name])
            if best_known is not None:
                times = self._best_known(best_known, motions)
                summaries, tables = self._write(folders, records, motions, times)
            about = describe(self.conditions, len(self.scenarios))
            for folder, results in tables.items():
                shown = {name: summaries[name] for name in results}
                files = " and ".join(str(folder / name) for name in FIGURES)
                draw_or_warn("study", files, partial(draw, folder, results, shown, about))
        return summaries

    def _with(self, strategy: str) -> StudyConditions:
        controller = replace(self.conditions.controller, strategy=strategy)
        return replace(self.conditions, controller=controller)

    def _records(
        self, conditions: StudyConditions, journal: Journal, workers: Workers,
        observer: Observer | None,
    ) -> list[RunRecord]:
        if observer is not None:
            for record in journal.records.values():
                observer(record)
        tasks = [
            (index, (conditions, scenario))
            for index, scenario in enumerate(self.scenarios)
            if index not in journal.records
        ]
        for index, record in workers.run(run_scenario, tasks, "run"):
            journal.append(index, record)
            if observer is not None:
                observer(record)
        return [journal.records[i] for i in range(len(self.scenarios))]

    def _best_known(
        self, search: BestKnown, motions: Mapping[str, Sequence[Motion]]
    ) -> dict[str, Sequence[float]]:
        """Return the settling time of the best known motion of each run [s], by strategy."""
        # The fastest motion to the end of a path does not follow it.
        judged = [scenario.follows is None for scenario in self.scenarios]
        all_motions = [motion for found in motions.values() for motion in compress(found, judged)]
        times = iter(search(all_motions))
        return {name: [next(times) if one else math.nan for one in judged] for name in motions}

    def _refuse_other_results(self, folders: Iterable[Path]) -> None:
        has_journals = any((folder / JOURNAL).exists() for folder in folders)
        alone = (self.folder / JOURNAL).exists()
        if alone or (not has_journals and (self.folder / "runs.csv").exists()):
            raise ResultFolderError(
                self.folder, "holds other results; choose another folder"
            )

    def _write(
        self, folders: Mapping[str, Path], records: Mapping[str, Sequence[RunRecord]],
        motions: Mapping[str, Sequence[Motion]], times: Mapping[str, Sequence[float]],
    ) -> tuple[dict[str, dict[str, Any]], dict[Path, dict[str, list[dict[str, Value]]]]]:
        """Write all tables; return summaries by strategy and results by folder."""
        robot = self.conditions.robot
        results = {
            name: with_bounds(
                [record.results for record in found],
                [motion.lower_bound(robot) for motion in motions[name]], times.get(name),
            )
            for name, found in records.items()
        }
        summaries = {name: summarise(self.scenarios, found) for name, found in results.items()}
        tables = {folder: {name: results[name]} for name, folder in folders.items()}
        tables[self.folder] = results
        for folder, table in tables.items():
            write_runs(folder / "runs.csv", self.scenarios, table.values())
            shown = {name: summaries[name] for name in table}
            content = {"strategies": shown} if len(shown) > 1 else next(iter(shown.values()))
            text = json.dumps(content, indent=1, allow_nan=False) + "\n"
            replace_file(folder / "summary.json", text.encode())
        return summaries, tables
