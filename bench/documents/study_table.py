# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of docs/results.md and docs/strategy.md from studies, or of folders of other studies.

    python bench/documents/study_table.py --out out/results --write     # an hour on two cores
    python bench/documents/study_table.py --out out/results --only noise effort
    python bench/documents/study_table.py out/mine out/others

The first two run the studies that are declared below, as far as their folder does not have them,
and print their tables; with ``--write`` those in docs/results.md are replaced. The third makes a
table of any studies.
"""

import argparse
import csv
import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tables import header, row

from sphere_nmpc.model.state import Vector
from sphere_sim.cli import study

_DOCUMENT = Path(__file__).parents[2] / "docs/results.md"


class Table(NamedTuple):
    """Table of the document: the study of each row, by its name, and what its columns are."""

    studies: dict[str, str]
    """Arguments of ``sphere_nmpc study``."""
    columns: str = "settling"


def _effort(margins: Sequence[float], arguments: str) -> dict[str, str]:
    return {f"margin {margin:g}": f"{arguments} --seed 1 --set controller.time_margin={margin}"
            for margin in margins}


TABLES = {
    "ideal": Table({
        "nominal, `paper`": "--draw 1000 --seed 1 --strategy paper",
        "nominal, the first 200": "--draw 200 --seed 1",
    }),
    "best known": Table({
        "nominal": "--draw 40 --seed 1",
        "nominal, `--seed 5`": "--draw 60 --seed 5",
        "nominal, `plan_keeping`": "--draw 40 --seed 1 --strategy plan_keeping",
        "nominal, `paper`": "--draw 40 --seed 1 --strategy paper",
        "parameters wrong by up to 3 %": "--draw 40 --seed 1 --perturb 3",
        "10 %": "--draw 40 --seed 1 --perturb 10",
        "20 %": "--draw 40 --seed 1 --perturb 20",
        "3 %, no learning": "--draw 40 --seed 1 --perturb 3 --no-learning",
        "contact, true parameters": "--draw 20 --seed 1 --plant rigid_body",
        "contact, 10 %": "--draw 20 --seed 1 --plant rigid_body --perturb 10",
    }, "over best known"),
    "wrong": Table({
        "3 %": "--draw 200 --seed 1 --perturb 3",
        "10 %": "--draw 200 --seed 1 --perturb 10",
        "20 %": "--draw 100 --seed 1 --perturb 20",
    }),
    "not learning": Table({
        "3 %, `paper`": "--draw 60 --seed 1 --perturb 3 --no-learning --strategy paper",
        "3 %": "--draw 60 --seed 1 --perturb 3 --no-learning",
        "10 %, `paper`": "--draw 60 --seed 1 --perturb 10 --no-learning --strategy paper",
        "10 %": "--draw 60 --seed 1 --perturb 10 --no-learning",
    }),
    "noise": Table({"noise": "--draw 60 --seed 1 --process-noise 1e-3"}, "loosely settling"),
    "hard": Table({
        "circle": "--draw 200 --seed 1 --kind circle",
        "half turn": "--draw 200 --seed 1 --kind half_turn",
        "far": "--draw 200 --seed 1 --kind far --duration 90",
        "1 km": "--draw 20 --seed 1 --kind kilometre --duration 1362",
    }),
    "contact": Table({
        "true parameters": "--draw 200 --seed 1 --plant rigid_body",
        "3 %": "--draw 200 --seed 1 --plant rigid_body --perturb 3",
        "10 %": "--draw 200 --seed 1 --plant rigid_body --perturb 10",
        "20 %": "--draw 200 --seed 1 --plant rigid_body --perturb 20",
    }),
    "contact, others": Table({
        "true parameters, no learning": "--draw 40 --seed 1 --plant rigid_body --no-learning",
        "true parameters, `paper`": "--draw 40 --seed 1 --plant rigid_body --strategy paper",
        "10 %, `paper`": "--draw 40 --seed 1 --plant rigid_body --perturb 10 --strategy paper",
    }),
    "effort": Table(_effort((0.0, 0.05, 0.1, 0.2, 0.5, 1.0), "--draw 40 --duration 20"), "effort"),
    "effort, far": Table(
        _effort((0.0, 0.1, 0.5), "--draw 8 --kind far --duration 130"), "effort"
    ),
}


_SETTLING = ("settled", "after: median / p99 / worst [s]", "error left: median / worst")
_COLUMNS = {
    "settling": _SETTLING, "loosely settling": _SETTLING,
    "over best known": ("settled", "ratio: median / p90 / p99 / worst"),
    "effort": ("settling: median / worst", "heat: median / worst", "energy: median / worst"),
}


def lines(studies: dict[str, Path], columns: str) -> str:
    """Return the table of the studies in some folders, by name."""
    runs = {name: _runs_of(folder) for name, folder in studies.items()}
    first = next(iter(runs.values()))
    return "\n".join([
        header("study", *_COLUMNS[columns]),
        *(row(name, *cells(found, columns, first)) for name, found in runs.items()),
    ])


def _runs_of(folder: Path) -> dict[str, Vector]:
    """Return the numbers of a study of one strategy, by column; nan where there is none."""
    with (folder / "runs.csv").open(encoding="utf-8", newline="") as file:
        runs = list(csv.DictReader(file))
    names = ("settle_time_s", "loose_settle_time_s", "bound_s", "final_error", "tail_error_p95",
             "heat", "energy_j")
    return {name: np.array([float(run.get(name) or "nan") for run in runs]) for name in names}


def cells(runs: dict[str, Vector], columns: str, first: dict[str, Vector]) -> list[str]:
    """Return the cells of one study; effort is over that of the first one, without a margin."""
    loose = columns == "loosely settling"
    after = runs["loose_settle_time_s" if loose else "settle_time_s"]
    settled = f"{np.isfinite(after).sum()} of {len(after)}"
    if columns == "effort":
        ratios = [after / runs["bound_s"], *(runs[n] / first[n] for n in ("heat", "energy_j"))]
        # A run that does not settle counts as infinite.
        return [_spread(np.where(np.isnan(one), np.inf, one), [50], ".3f") for one in ratios]
    if columns == "over best known":
        return [settled, _spread(after / runs["bound_s"], [50, 90, 99], ".3f")]
    error = runs["tail_error_p95" if loose else "final_error"]
    left = f"{np.nanmedian(error):.1e} / {np.nanmax(error):.1e}"
    return [settled, _spread(after, [50, 99], ".2f"), left]


def _spread(values: Vector, shares: Sequence[float], how: str) -> str:
    known = values[~np.isnan(values)]
    if not known.size:
        return "-"
    return " / ".join(format(v, how) for v in (*np.percentile(known, shares), known.max()))


def made(name: str, table: Table, out: Path) -> str:
    """Return a declared table after running its studies, those that are complete excepted."""
    folders = {}
    for number, (study_name, arguments) in enumerate(table.studies.items(), 1):
        folders[study_name] = folder = out / f"{name} {number}".replace(" ", "_")
        bound = [] if table.columns in ("over best known", "effort") else ["--no-bound"]
        if study.main([*shlex.split(arguments), *bound, "--out", str(folder)]):
            sys.exit(f"{name}, {study_name}: the study has failed")
    return lines(folders, table.columns)


def replaced(text: str, name: str, table: str) -> str:
    """Return the text of a document with another table below the comment with its name."""
    mark = f"<!-- table: {name} -->\n"
    assert mark in text, f"the document has no {mark}"
    return re.sub(re.escape(mark) + r"(\|.*\n)*", lambda _: f"{mark}{table}\n", text)


def main() -> None:
    """Print, and write, the tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folders", type=Path, nargs="*", help="studies of one strategy each")
    parser.add_argument("--out", type=Path, help="folder for the studies that are declared")
    parser.add_argument("--only", choices=TABLES, nargs="+", default=list(TABLES))
    parser.add_argument("--write", action="store_true", help="replace the document's tables")
    given = parser.parse_args()
    if given.folders:
        print(lines({folder.name: folder for folder in given.folders}, "settling"))
        return
    if given.out is None:
        parser.error("given neither folders nor --out")
    for name in given.only:
        table = made(name, TABLES[name], given.out)
        print(f"{name}:\n{table}\n", flush=True)
        if given.write and TABLES[name].columns != "effort":
            text = _DOCUMENT.read_text(encoding="utf-8")
            _DOCUMENT.write_text(replaced(text, name, table), encoding="utf-8")


if __name__ == "__main__":
    main()
