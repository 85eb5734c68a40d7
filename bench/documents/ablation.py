# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Ablation: what each number of the strategy `time_optimal` and of the estimator is worth.

    python bench/documents/ablation.py strategy                 # all numbers, half an hour
    python bench/documents/ablation.py estimator push tilt=10   # some, one to a given value
    python bench/documents/ablation.py constants strategy.time_optimal.guide:_MAX_GOAL_DISTANCE=7.0

A number is changed by a factor that is large for it, and the runs of the studies that it matters
for are made as with the defaults. For each study the mean change of the settling time is printed
with its standard error; a run that does not settle counts as `NEVER`. What is chance shows in a
slight change of a number of the search, which leads to other guesses.
"""

import argparse
import ast
import dataclasses
import importlib
import sys
import time
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from tables import UNDISTURBED, Row, Table, conditions_of, drawn

from sphere_nmpc.control import planner
from sphere_nmpc.estimation import estimator
from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy
from sphere_sim.scenario.perturbation import DisturbanceDraws
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import run_scenario
from sphere_sim.study.workers import cores


@dataclass(frozen=True)
class Constants:
    """Constants of modules that have other values, by ``module:NAME`` in `sphere_nmpc`."""

    changed: tuple[tuple[str, Any], ...] = ()

    def apply(self, patches: ExitStack) -> None:
        """Change them wherever they were imported, but for defaults of parameters."""
        for word, value in self.changed:
            place, name = word.split(":")
            default = getattr(importlib.import_module(f"sphere_nmpc.{place}"), name)
            for module in list(sys.modules.values()):
                if module.__name__.startswith("sphere_nmpc.") and (
                    getattr(module, name, None) is default
                ):
                    patches.enter_context(patch.object(module, name, value))


Numbers = TimeOptimalSettings | EstimatorSettings | Constants

NEVER = 1.5
"""Settling time of a run that does not settle [of its length]."""


@dataclass(frozen=True)
class Study:
    """Runs that some numbers matter for, with the result that is compared.

    `loose` judges them by an error of 5e-2.
    """

    name: str
    runs: int
    seed: int
    settings: str
    kind: str = "anywhere"
    percent: float = 3.0
    duration: float = 20.0
    draws: DisturbanceDraws = UNDISTURBED
    loose: bool = False
    result: str = "settle_time_s"

    @property
    def conditions(self) -> StudyConditions:
        """Conditions of the runs."""
        return conditions_of(self.settings, self.duration, self.percent)

    @property
    def scenarios(self) -> list[Scenario]:
        """Scenarios with their disturbances."""
        return drawn(self.conditions, self.runs, self.seed, self.kind, self.draws)

    @property
    def metric(self) -> str:
        """Result of a run that is compared."""
        return "loose_settle_time_s" if self.loose else self.result


def _pushed(time: float) -> DisturbanceDraws:
    return DisturbanceDraws(push=(0.2, 1.0), push_time=time)


_CONTACT = "simulator.plant=rigid_body "
_NOISE = _CONTACT + "simulator.position_noise=0.005 simulator.orientation_noise=0.01745 "
_GIVEN = "controller.pose_position_noise=0.005 controller.pose_orientation_noise=0.01745"
EXACT = Study("exact", 30, 1, "", percent=0.0)
WRONG = Study("parameters 10 % wrong", 8, 1, "", percent=10.0)
PUSHED = Study("pushed at 0.3 s", 12, 101, _CONTACT, "upright", draws=_pushed(0.3))
SLIPPERY = Study("friction 0.2", 6, 1, _CONTACT + "rigid_body.friction=0.2", percent=0.0)
SLOPE = Study(
    "slope 0.1°, 0.5 mm off", 10, 5, _CONTACT, "upright",
    draws=DisturbanceDraws(slope=float(np.radians(0.1)), offset=5e-4),
)
DIFFUSING = Study("process noise", 8, 1, "simulator.process_noise=1e-3", percent=0.0, loose=True)
NOISY = Study("noise given", 6, 1, _NOISE + _GIVEN, loose=True)
NOISY_PUSHED = Study(
    "noise, pushed", 12, 1, _NOISE + _GIVEN, "upright", draws=_pushed(1.0), loose=True
)
NOT_GIVEN = Study("noise not given", 4, 1, _NOISE, loose=True)
WEAK = Study("weak drives", 6, 1, _CONTACT + "rigid_body.torque_limit=2.4")
FAR = Study("far", 8, 1, "", "far", percent=0.0, duration=100.0)
SPARED = Study("margin 0.01", 20, 1, "controller.time_margin=0.01", percent=0.0)
HEAT = Study("heat, margin 0.5", 20, 1, "controller.time_margin=0.5", percent=0.0, result="heat")
_MAP_FILE = Path(__file__).resolve().parents[2] / "config" / "maps" / "two_rooms.yaml"
MAP = Study("map", 12, 1, f"floor.map_file={_MAP_FILE}", percent=0.0, duration=40.0)
_MOMENTUM, _NOISES = (PUSHED, SLOPE), (DIFFUSING, NOISY, NOISY_PUSHED)
_ESTIMATOR = (WRONG, PUSHED, SLIPPERY, SLOPE, DIFFUSING, NOISY, NOT_GIVEN, WEAK)

Studies = tuple[Study, ...]
CHANGED: dict[type[Numbers], dict[str, tuple[tuple[Any, ...], Studies]]] = {
    TimeOptimalSettings: {
        "spacing": ((0.3, 0.6), (EXACT,)),
        "trial_iterations": ((6, 24), (EXACT,)),
        "error_weight": ((5.0, 20.0), (EXACT,)),
        "iterations": ((4, 16), (EXACT,)),
        "effort_weight": ((0.02, 0.5), (SPARED, HEAT)),
        "sparing_iterations": ((25, 400), (SPARED, HEAT)),
        "momentum_weight": ((0.0, 0.06), (SLOPE,)),
        "arrival_error": ((2e-4,), (EXACT,)),
        "half_motions": ((1024, 9216), (EXACT,)),
        "tried_guesses": ((8, 32), (EXACT,)),
        "polished": ((1, 12), (EXACT, WEAK)),
        "window": ((2.0, 8.0), (EXACT,)),
        "turn_weight": ((5.5, 88.0), (EXACT,)),
        "mean_switch": ((0.6, 5.0), (EXACT,)),
        "near_radii": ((5.0, 20.0), (FAR,)),
        "noisy_share": ((0.0, 1.0), _NOISES),
        "largest_growth": ((1.0,), (EXACT, *_MOMENTUM, WEAK)),
        "failed_searches": ((1, 1000000), (EXACT, WRONG, FAR)),
        "slip_acceleration": ((1.0,), (SLIPPERY,)),
        "attained_share": ((0.9, 1.0), (WEAK,)),
        "largest_change_of_goal": ((0.05, 10.0), _MOMENTUM),
        "unloading_share": ((0.5,), (SLOPE,)),
        "turning_time": ((0.3, 5.0), _MOMENTUM),
        "least_dead_band": ((5e-4, 8e-3), (EXACT, *_NOISES)),
        "noise_factor": ((20.0, 120.0), _NOISES),
        "uncertainty_factor": ((1.0, 9.0), _NOISES),
        "leaving_error": ((2e-3,), (EXACT, *_MOMENTUM, *_NOISES)),
        "correction_weight": ((10.0, 1000.0), (*_MOMENTUM, *_NOISES)),
    },
    EstimatorSettings: {
        name: ((value,), _ESTIMATOR) for name, value in {
            "spacing": 0.4, "known": 2e-2, "longest": 0.5,
            "pose_spacing": 0.1, "lead": 0.1, "window": 4, "step": 0.15,
            "constants": (0.04, 0.07, 0.02, 0.03), "lag": 2e-2, "longest_lag": 0.0, "share": 0.05,
            "imbalance": 3.0, "pose": 1e-4, "prediction": 1e-3, "share_spread": 3e-3,
            "momentum_walk": 5e-3, "slope_walk": 1e-2, "push": 15.0, "tilt": 5.0, "slip": 0.06,
            "late": 0.03,
            "rare": 7.0, "again": 14.0, "improbable": 75.0, "slippery": 5,
            "most_outliers": 0,
        }.items()
    },
    Constants: {},
}
"""Other values of the numbers, and the studies that are made with them.

`search_ahead` and `longest_search` have no effect without a worker, and a study has none."""
OF_CONSTANTS: dict[str, Studies] = {
    "strategy": (EXACT, *_MOMENTUM, MAP, FAR), "floor": (MAP,), "estimation": _ESTIMATOR,
    "control": (EXACT, *_MOMENTUM, *_NOISES), "solver": (EXACT, *_MOMENTUM),
}
"""Studies that are made with another constant of a module, by package."""
KINDS: dict[str, type[Numbers]] = {
    "strategy": TimeOptimalSettings, "estimator": EstimatorSettings, "constants": Constants,
}


def measured(
    numbers: Numbers, conditions: StudyConditions, scenario: Scenario, study: Study = EXACT
) -> tuple[str, float, float]:
    """Make a run of a study with other settings; called in a process of the pool.

    Returns the name of the study, its result, that of `NEVER` where the run did not settle, and
    its processor time [s].
    """

    def tuned(
        settings: ControllerSettings, robot: RobotParameters, worker: object = None
    ) -> TimeOptimalStrategy:
        of_strategy = numbers if isinstance(numbers, TimeOptimalSettings) else None
        return TimeOptimalStrategy(settings, robot, of_strategy)

    _load(conditions, scenario)
    of_estimator = estimator.TABLE_1_NUMBERS
    if isinstance(numbers, EstimatorSettings):
        of_estimator = numbers
    with ExitStack() as patches:
        patches.enter_context(patch.object(planner, "make_strategy", tuned))
        patches.enter_context(patch.object(estimator, "TABLE_1_NUMBERS", of_estimator))
        if isinstance(numbers, Constants):
            numbers.apply(patches)
        began = time.process_time()
        found = run_scenario(conditions, scenario).results.get(study.metric)
        spent = time.process_time() - began
    return study.name, found if isinstance(found, float) else NEVER * study.duration, spent


@cache
def _load(conditions: StudyConditions, scenario: Scenario) -> None:
    """Load what a process loads with its first run, which is not part of a measurement."""
    if not _load.cache_info().currsize:
        run_scenario(dataclasses.replace(conditions, duration=0.5), scenario)


def row_of(
    names: tuple[object, ...], numbers: Numbers, studies: Iterable[Study]
) -> Row:
    """Return the row of all runs of studies with some numbers."""
    return Row(names, [(numbers, study.conditions, scenario, study)
                       for study in studies for scenario in study.scenarios])


def cells(found: list[Any], default: list[Any]) -> list[str]:
    """Return in words how the runs of each study differ from those with the defaults."""
    words = []
    for name in dict.fromkeys(run[0] for run in found):
        runs, before = (np.array([run[1:] for run in some if run[0] == name])
                        for some in (found, default))
        if found is default:
            words.append(f"{name}: {len(runs)} runs, mean {runs[:, 0].mean():.2f}")
            continue
        change = runs[:, 0] - before[:, 0]
        error = float(np.std(change, ddof=1)) / np.sqrt(change.size)
        mean = f"{np.mean(change):+.2f} ± {error:.2f}" if change.any() else "0"
        unit = "N² m² s" if name == HEAT.name else "s"
        words.append(f"{name} {mean} {unit} ({runs[:, 1].mean() / before[:, 1].mean():.2f})")
    return ["; ".join(words)]


def variants(kind: type[Numbers], words: Iterable[str]) -> list[tuple[str, Any, Studies]]:
    """Return name, value and studies of the numbers that words name, ``name`` or ``name=value``.

    Without words those of all numbers. A word that names no number is a ValueError.
    """
    known, found = CHANGED[kind], list[tuple[str, Any, Studies]]()
    for word in words or known:
        name, has_value, text = word.partition("=")
        if kind is Constants and ":" in name and has_value:
            found.append((name, ast.literal_eval(text), OF_CONSTANTS[name.split(".")[0]]))
            continue
        if name not in known:
            raise ValueError(f"{name}: no number of {kind.__name__}")
        values, studies = known[name]
        found += [
            (name, value, studies)
            for value in ((ast.literal_eval(text),) if has_value else values)
        ]
    return found


def main() -> None:
    """Make the runs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("variants", nargs="*", metavar="NAME[=VALUE]")
    parser.add_argument("--jobs", type=int, default=cores())
    given = parser.parse_args()
    defaults = KINDS[given.kind]()
    try:
        wanted = variants(type(defaults), given.variants)
    except (ValueError, SyntaxError) as error:
        parser.error(str(error))
    limit_library_threads()  # for the processes, which inherit it
    needed = dict.fromkeys(study for _, _, studies in wanted for study in studies)
    rows = [row_of(("defaults", "", ""), defaults, needed)]
    for name, value, studies in wanted:
        one = {"changed": ((name, value),)} if given.kind == "constants" else {name: value}
        numbers = dataclasses.replace(defaults, **one)
        rows.append(row_of((f"`{name}`", getattr(defaults, name, ""), value), numbers, studies))
    columns = ("number", "default", "changed to",
               "mean change of the settling time (processor time over the default's)")
    Table(columns, lambda *_: rows, measured, cells).printed(jobs=given.jobs)


if __name__ == "__main__":
    main()
