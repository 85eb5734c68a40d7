# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What each number of the estimator is worth, over eight studies.

    python bench/documents/estimator_numbers.py              # all of them, half an hour
    python bench/documents/estimator_numbers.py push tilt    # some

Each number is changed by a factor that is large for it, and the same runs of several studies are
made as with the defaults. A cell is the mean change of the settling time [s] with its standard
error; a run that does not settle counts as `LONGEST`.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from ablation import measured
from tables import header, in_processes, row

from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.library_threads import limit_library_threads
from sphere_nmpc.model.state import Vector
from sphere_sim.scenario.perturbation import DisturbanceDraws
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.workers import cores

LONGEST = 30.0
"""Settling time of a run of `DURATION` that does not settle [s]."""
DURATION = 20.0
"""Length of a run [s]."""

_NUMBERS = EstimatorSettings()
CHANGED: dict[str, Any] = {
    "spacing": 0.4, "longest": 0.5, "pose_spacing": 0.1, "lead": 0.1, "window": 4, "step": 0.15,
    "constants": 0.03, "lag": 2e-2, "longest_lag": 0.0, "share": 0.05, "imbalance": 3.0,
    "pose": 1e-4, "prediction": 1e-3, "share_spread": 3e-3, "momentum_walk": 5e-3,
    "slope_walk": 1e-2, "push": 15.0, "tilt": 5.0, "slip": 0.06, "rare": 7.0, "again": 14.0,
    "improbable": 75.0, "slippery": 5, "recent": 2, "most_outliers": 0,
}
"""Other values of the numbers."""
_UNDISTURBED = DisturbanceDraws()


@dataclass(frozen=True)
class Study:
    """Runs that some numbers matter for; `loose` judges them by an error of 5e-2."""

    name: str
    runs: int
    seed: int
    settings: str
    kind: str = "anywhere"
    percent: float = 3.0
    draws: DisturbanceDraws = _UNDISTURBED
    loose: bool = False

    @property
    def conditions(self) -> StudyConditions:
        """Conditions of the runs."""
        pairs = [tuple(one.split("=")) for one in self.settings.split()]
        plain = StudyConditions(duration=DURATION, perturbation=self.percent)
        return plain.with_settings([(name, value) for name, value in pairs])

    @property
    def scenarios(self) -> list[Scenario]:
        """Scenarios with their disturbances."""
        drawn = draw_scenarios(self.runs, self.seed, self.kind)
        return [self.draws.applied_to(scenario) for scenario in drawn]

    @property
    def metric(self) -> str:
        """Result of a run that is compared."""
        return "loose_settle_time_s" if self.loose else "settle_time_s"


_CONTACT = "simulator.plant=rigid_body "
_NOISE = _CONTACT + "simulator.position_noise=0.005 simulator.orientation_noise=0.01745 "
_GIVEN = "controller.pose_position_noise=0.005 controller.pose_orientation_noise=0.01745"
STUDIES = (
    Study("parameters 10 % wrong", 8, 1, "", percent=10.0),
    Study("pushed at 0.3 s", 8, 101, _CONTACT, "upright", draws=DisturbanceDraws((0.2, 1.0), 0.3)),
    Study("friction 0.2", 6, 1, _CONTACT + "rigid_body.friction=0.2", percent=0.0),
    Study(
        "slope 0.1°, 0.5 mm off", 8, 5, _CONTACT, "upright",
        draws=DisturbanceDraws(slope=float(np.radians(0.1)), offset=5e-4),
    ),
    Study("process noise", 8, 1, "simulator.process_noise=1e-3", percent=0.0, loose=True),
    Study("noise given", 4, 1, _NOISE + _GIVEN, loose=True),
    Study("noise not given", 4, 1, _NOISE, loose=True),
    Study("weak drives", 6, 1, _CONTACT + "rigid_body.torque_limit=2.4"),
)


def settling(numbers: EstimatorSettings, jobs: int) -> list[Vector]:
    """Return the settling times of the runs of each study [s]."""
    tasks = [
        (numbers, study.conditions, scenario, study.metric)
        for study in STUDIES for scenario in study.scenarios
    ]
    times = np.array(in_processes(measured, tasks, jobs))[:, 0]
    times = np.where(np.isfinite(times), times, LONGEST)
    return np.split(times, np.cumsum([study.runs for study in STUDIES])[:-1])


def compared(found: Sequence[Vector], before: Sequence[Vector]) -> list[str]:
    """Return the mean change of each study and its standard error."""
    cells = []
    for after, default in zip(found, before, strict=True):
        change = after - default
        error = float(np.std(change, ddof=1)) / np.sqrt(change.size)
        cells.append("0" if not change.any() else f"{np.mean(change):+.2f} ± {error:.2f}")
    return cells


def main() -> None:
    """Make the runs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--jobs", type=int, default=cores())
    given = parser.parse_args()
    unknown = sorted(set(given.names) - set(CHANGED))
    if unknown:
        parser.error(f"{', '.join(unknown)}: no number of EstimatorSettings")
    limit_library_threads()  # for the processes, which inherit it
    print(header("number", "default", "changed to", *(study.name for study in STUDIES)))
    before = settling(_NUMBERS, given.jobs)
    print(row("mean [s]", "", "", *(f"{times.mean():.2f}" for times in before)), flush=True)
    for name in given.names or CHANGED:
        found = settling(dataclasses.replace(_NUMBERS, **{name: CHANGED[name]}), given.jobs)
        default = getattr(_NUMBERS, name)
        print(row(f"`{name}`", default, CHANGED[name], *compared(found, before)), flush=True)


if __name__ == "__main__":
    main()
