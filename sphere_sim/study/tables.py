# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Result files: a table with one row for each run, and the rotor speeds of all runs."""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sphere_sim.output.atomic_write import write_atomically
from sphere_sim.scenario.csv_file import SEED_COLUMN, STATE_COLUMNS
from sphere_sim.scenario.scenarios import DISTURBANCE_COLUMNS, PUSH_COLUMNS, Scenario
from sphere_sim.study.errors import NotWrittenError
from sphere_sim.study.record import (
    PUSH_RESULT_COLUMNS,
    RESULT_COLUMNS,
    RunRecord,
    Value,
)


def replace_file(path: Path, content: bytes | memoryview) -> None:
    """Replace a file; where that fails, the previous one is kept.

    Raises
    ------
    NotWrittenError
        Naming the file and the reason.
    """
    try:
        write_atomically(path, content)
    except OSError as error:
        raise NotWrittenError(path, error) from None


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
        Results of all scenarios by the names of their columns, for each strategy.
    """
    # A table of results may be the scenario file; its previous results are replaced.
    names = dict.fromkeys(name for scenario in scenarios for name in scenario.extra)
    pushed = any(scenario.push is not None for scenario in scenarios)
    result_names = RESULT_COLUMNS + (PUSH_RESULT_COLUMNS if pushed else ())
    extras = [n for n in names if n not in RESULT_COLUMNS + PUSH_RESULT_COLUMNS]
    present = {name for scenario in scenarios for name in scenario.optional}
    optional = [name for name in PUSH_COLUMNS + DISTURBANCE_COLUMNS if name in present]
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow([*STATE_COLUMNS, SEED_COLUMN, *optional, *extras, *result_names])
    for of_strategy in results:
        for scenario, found in zip(scenarios, of_strategy, strict=True):
            values = np.concatenate((scenario.start, scenario.goal)).tolist()
            cells: list[Value] = [
                scenario.given.get(name, value)
                for name, value in zip(STATE_COLUMNS, values, strict=True)
            ]
            cells.append(scenario.seed)
            cells += [scenario.optional.get(name) for name in optional]
            cells += [scenario.extra.get(name, "") for name in extras]
            cells += [found.get(name) for name in result_names]
            # Python writes the shortest text that reads back as the same number.
            writer.writerow(["" if cell is None else cell for cell in cells])
    replace_file(path, table.getvalue().encode())


def write_inputs(path: Path, records: Sequence[RunRecord]) -> None:
    """Write times ``t_i`` [s], shape (K,), and rotor speeds ``u_i`` [rad/s], (K, 2), of run i."""
    arrays: dict[str, Any] = {}
    for i, record in enumerate(records):
        arrays |= {f"t_{i}": record.times, f"u_{i}": record.speeds}
    archive = io.BytesIO()
    np.savez_compressed(archive, **arrays)
    replace_file(path, archive.getbuffer())
