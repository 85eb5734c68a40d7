# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settling times in the paper's cases, by plant and strategy.

Without noise, with exact parameters and in lockstep. Prints the table of ``docs/results.md``
without the best known motions, for which a study searches:

    python bench/documents/case_table.py
"""

from collections.abc import Sequence

from tables import header, in_processes, row

from sphere_nmpc.settings import ControllerSettings
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import run_scenario
from sphere_sim.world.settings import SimulatorSettings

ROWS = (
    ("rolling", "time_optimal"), ("rolling", "plan_keeping"), ("rolling", "paper"),
    ("rigid_body", "time_optimal"), ("rigid_body", "paper"),
)
"""Plant and strategy of each row."""
_DURATION = 20.0
"""Length of a run [s]; the slowest settle after 12.6 s."""


def settling(plant: str, strategy: str, case: int) -> float:
    """Return when a run of a case has settled [s]; NaN if it has not."""
    conditions = StudyConditions(
        duration=_DURATION, controller=ControllerSettings(strategy=strategy),
        simulator=SimulatorSettings(plant=plant),
    )
    found = run_scenario(conditions, PAPER_CASES[case]).results["settle_time_s"]
    return float("nan") if found is None else float(found)


def table(rows: Sequence[tuple[str, str]] = ROWS) -> list[list[float]]:
    """Return the settling times [s] in all cases, a list a row, computed in several processes."""
    tasks = [(*names, case) for names in rows for case in PAPER_CASES]
    found = in_processes(settling, tasks)
    return [found[i : i + len(PAPER_CASES)] for i in range(0, len(found), len(PAPER_CASES))]


def main() -> None:
    """Print the table."""
    print(header("plant", "strategy", *map(str, PAPER_CASES)))
    for (plant, strategy), times in zip(ROWS, table(), strict=True):
        print(row(plant, f"`{strategy}`", *(f"{time:.2f}" for time in times)))


if __name__ == "__main__":
    main()
