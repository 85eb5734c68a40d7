# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures of README.md and docs/figures.md from runs over ROS 2.

    python bench/documents/document_figures.py --out docs/figures

Each run is a demo in lockstep, hence repeatable to the bit. Bags that are already in --runs are
not recorded again.
"""

import argparse
import json
import subprocess
from pathlib import Path

from matplotlib.figure import Figure
from tables import row

from sphere_sim.recording.run_reader import read_run
from sphere_sim.report.figures.animation import write_animation
from sphere_sim.report.figures.paper import contact_locus, paper_panels
from sphere_sim.report.figures.style import styled
from sphere_sim.ros.session.process_set import verb_command
from sphere_sim.scenario.scenarios import PAPER_CASES

STRATEGIES = ("paper", "time_optimal")


def record(runs: Path, case: int, strategy: str) -> Path:
    """Return the folder of a demo; the demo is run if the folder does not exist."""
    folder = runs / f"{strategy}_{case}"
    if not (folder / "summary.json").exists():
        command = ["demo", "--rtf", "0", "--case", str(case), "--strategy", strategy]
        command = verb_command(*command, "--no-viewer", "--out", str(folder))
        subprocess.run(command, check=False)  # in case 4 the paper's controller may not arrive
    return folder


def save(figure: Figure, path: Path) -> None:
    with styled():
        figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/figures"))
    parser.add_argument("--runs", type=Path, default=Path("runs/documents"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for case in PAPER_CASES:
        for strategy in STRATEGIES:
            folder = record(given.runs.absolute(), case, strategy)
            metrics = json.loads((folder / "summary.json").read_text())["metrics"]
            rows.append((case, strategy, metrics))
        run = read_run(given.runs.absolute() / f"paper_{case}" / "bag")
        number = case + 2
        save(paper_panels(run, f"case {case}, strategy paper"), given.out / f"fig{number}.png")
        save(contact_locus(run), given.out / f"fig7_case{case}.png")
    first = given.runs.absolute() / "time_optimal_1"
    (given.out / "comparison.png").write_bytes((first / "comparison.png").read_bytes())
    write_animation(read_run(first / "bag"), given.out / "run.gif")
    names = ("settle_time_s", "within_s", "p95_error_after", "final_error",
             "max_rotor_torque_nm", "solve_ms_p50", "solve_ms_p99")
    print(row("case", "strategy", *names))
    for case, strategy, metrics in rows:
        values = ("-" if metrics[name] is None else f"{metrics[name]:.3g}" for name in names)
        print(row(case, f"`{strategy}`", *values))


if __name__ == "__main__":
    main()
