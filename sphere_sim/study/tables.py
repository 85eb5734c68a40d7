# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Results as files: a row a run, and the rotor speeds of every run."""

import contextlib
import csv
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sphere_sim.scenario_file import SEED_COLUMN, STATE_COLUMNS
from sphere_sim.scenarios import Scenario
from sphere_sim.study.record import RESULT_COLUMNS, RunRecord, Value


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield another path to write to, which takes the place of `path` when all went well."""
    fresh = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield fresh
        os.replace(fresh, path)
    finally:
        fresh.unlink(missing_ok=True)


def write_runs(
    path: Path, scenarios: Sequence[Scenario], results: Iterable[Sequence[dict[str, Value]]]
) -> None:
    """Write the table of all runs.

    Parameters
    ----------
    path : Path
        The CSV file.
    scenarios : sequence of Scenario
        In the order of the rows.
    results : iterable of sequences of dict
        For each strategy the results of all scenarios, by names of `RESULT_COLUMNS`.
    """
    # A table of results may serve as scenario file; its old results give way to the new ones.
    names = dict.fromkeys(name for scenario in scenarios for name in scenario.extra)
    extras = [name for name in names if name not in RESULT_COLUMNS]
    with replacing(path) as fresh, fresh.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*STATE_COLUMNS, SEED_COLUMN, *extras, *RESULT_COLUMNS])
        for of_strategy in results:
            for scenario, found in zip(scenarios, of_strategy, strict=True):
                values = np.concatenate((scenario.start, scenario.goal)).tolist()
                cells: list[Value] = [
                    scenario.given.get(name, value)
                    for name, value in zip(STATE_COLUMNS, values, strict=True)
                ]
                cells.append(scenario.seed)
                cells += [scenario.extra.get(name, "") for name in extras]
                cells += [found.get(name) for name in RESULT_COLUMNS]
                # Python writes the shortest text that reads back as the same number.
                writer.writerow(["" if cell is None else cell for cell in cells])


def write_inputs(path: Path, records: Sequence[RunRecord]) -> None:
    """Write the knots of run i as ``t_i`` [s], shape (K,), and ``u_i`` [rad/s], shape (K, 2)."""
    arrays: dict[str, Any] = {}
    for i, record in enumerate(records):
        arrays[f"t_{i}"] = np.array(record.times, dtype=float)
        arrays[f"u_{i}"] = np.array(record.speeds, dtype=float).reshape(-1, 2)
    with replacing(path) as fresh:
        np.savez_compressed(fresh, **arrays)
