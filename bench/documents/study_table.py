# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Table for docs/results.md from the folders of several studies.

    python bench/documents/study_table.py out/nominal out/wrong_3 out/noise

The settling time is compared with that of the best known motion, or with ``--beyond`` with the
lower bound, as suits far goals. With ``--loose``, for runs with noise, it is the first time from
which on the error stays below 5e-2, which is not compared, and the error is the 95th percentile
from then on.
"""

import argparse
import csv
import json
from pathlib import Path

import numpy as np
from tables import header
from tables import row as table_row

from sphere_nmpc.model.state import Vector

_HEADER = (
    "study", "strategy", "settled", "after: median / p99 / worst [s]",
    "{compared}: median / p99 / worst{unit}", "error left: median / worst", "largest plan [ms]",
)


def main() -> None:
    """Print a row for each strategy of each study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--loose", action="store_true")
    parser.add_argument("--beyond", action="store_true")
    given = parser.parse_args()
    compared = ("beyond lower bound", " [s]") if given.beyond else ("over best known", "")
    print(header(*(name.format(compared=compared[0], unit=compared[1]) for name in _HEADER)))
    for folder in given.folders:
        for runs in sorted([*folder.glob("runs.csv"), *folder.glob("*/runs.csv")]):
            # With several strategies the folder itself repeats the rows of all of them.
            if not (runs.parent / "inputs.npz").exists():
                continue
            print(row(folder.name, runs.parent, given.loose, given.beyond))


def row(name: str, folder: Path, loose: bool, beyond: bool) -> str:
    """Return the row of one strategy of one study."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    with (folder / "runs.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    after = _numbers(rows, "loose_settle_time_s" if loose else "settle_time_s")
    bound = _numbers(rows, "lower_bound_s" if beyond else "bound_s")
    compared = after - bound if beyond else after / bound
    if loose:
        compared = np.full_like(after, np.nan)
    error = _numbers(rows, "tail_error_p95" if loose else "final_error")
    return table_row(
        name, f"`{rows[0]['strategy']}`", f"{np.isfinite(after).sum()} of {len(rows)}",
        _spread(after, ".2f"), _spread(compared, ".2f"),
        f"{np.nanmedian(error):.1e} / {np.nanmax(error):.1e}",
        f"{summary['timing']['solve_ms_max']:.0f}",
    )


def _numbers(rows: list[dict[str, str]], name: str) -> Vector:
    return np.array([float(row.get(name) or "nan") for row in rows])


def _spread(values: Vector, how: str) -> str:
    known = values[np.isfinite(values)]
    if not known.size:
        return "-"
    return " / ".join(format(v, how) for v in (*np.percentile(known, [50, 99]), known.max()))


if __name__ == "__main__":
    main()
