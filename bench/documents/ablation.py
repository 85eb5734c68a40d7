# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Ablation of `time_optimal`: what each number of its settings is worth.

    python bench/documents/ablation.py --draw 200
    python bench/documents/ablation.py least_dead_band slew_weight=20
    python bench/documents/ablation.py --plant rigid_body --perturb 10

Each number is halved and doubled, or set to a given value, and the same scenarios are run as with
the default settings. Settling times are compared run by run. What is chance shows in a slight
change of a number of the search, which leads to other guesses. Without names all numbers are
varied.
"""

import argparse
import ast
import dataclasses
import time
from collections.abc import Sequence
from functools import cache
from typing import Any
from unittest.mock import patch

import numpy as np
from tables import header, in_processes, row

from sphere_nmpc.control import controller
from sphere_nmpc.estimation import estimator
from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.library_threads import limit_library_threads
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy
from sphere_sim.scenario.scenarios import DRAWS, Scenario, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import run_scenario
from sphere_sim.study.workers import cores
from sphere_sim.world.settings import PLANTS

Numbers = TimeOptimalSettings | EstimatorSettings
Variant = tuple[str, Any]
"""Number of the settings and its value."""


def variants(words: Sequence[str], defaults: TimeOptimalSettings) -> list[Variant]:
    """Return the variants that words ask for: ``name`` or ``name=value``; all without words.

    A word that names no number, or a value that is not of its type, is a ValueError.
    """
    known: dict[str, Any] = {field.name: field.default for field in dataclasses.fields(defaults)}
    kind, found = type(defaults).__name__, list[Variant]()
    for word in words or [name for name, value in known.items() if type(value) in (int, float)]:
        name, has_value, text = word.partition("=")
        default = known.get(name)
        if has_value:
            value = ast.literal_eval(text)
            value = float(value) if isinstance(default, float) else value
            if type(value) is not type(default):
                raise ValueError(f"{word}: no field of {kind}, or not of its type")
            found.append((name, value))
        elif isinstance(default, (int, float)) and not isinstance(default, bool):
            scaled = [type(default)(factor * default) for factor in (0.5, 2)]
            found += [(name, value) for value in scaled if value != default]
        else:
            raise ValueError(f"{name}: no number of {kind}; give {name}=VALUE")
    return list(dict.fromkeys(found))


def measured(
    numbers: Numbers, conditions: StudyConditions, scenario: Scenario,
    metric: str = "settle_time_s",
) -> tuple[float, float]:
    """Make a run with other settings; called in a process of the pool.

    Returns its settling time [s], the result `metric`, nan where it did not settle, and its
    processor time [s].
    """

    def tuned(settings: ControllerSettings, robot: RobotParameters) -> TimeOptimalStrategy:
        of_strategy = numbers if isinstance(numbers, TimeOptimalSettings) else None
        return TimeOptimalStrategy(settings, robot, of_strategy)

    _load(conditions, scenario)
    of_estimator = estimator.TABLE_1_NUMBERS
    if isinstance(numbers, EstimatorSettings):
        of_estimator = numbers
    with (
        patch.object(controller, "make_strategy", tuned),
        patch.object(estimator, "TABLE_1_NUMBERS", of_estimator),
    ):
        began = time.process_time()
        found = run_scenario(conditions, scenario).results.get(metric)
        return float(found) if isinstance(found, float) else np.nan, time.process_time() - began


@cache
def _load(conditions: StudyConditions, scenario: Scenario) -> None:
    """Load what a process loads with its first run, which is not part of a measurement."""
    if not _load.cache_info().currsize:
        run_scenario(dataclasses.replace(conditions, duration=0.5), scenario)


def compared(name: str, known: object, value: object, runs: Vector, default: Vector) -> str:
    """Return the row of a variant: runs and those with the defaults, times as in `measured`."""
    after, before = runs[:, 0], default[:, 0]
    both = np.isfinite(after) & (before > 0.0)
    ratios, spread = after[both] / before[both], "-"
    if ratios.size:
        median, p90 = np.percentile(ratios, [50, 90])
        spread = f"{median:.3f} / {p90:.3f} / {ratios.max():.3f}"
    spent, spent_before = runs[:, 1].mean(), default[:, 1].mean()
    return row(
        f"`{name}`" if name else "none", known, value,
        f"{np.isfinite(after).sum()} of {len(runs)}", spread,
        f"{spent:.2f}", f"{spent / spent_before:.2f}",
    )


def main() -> None:
    """Make the runs of all variants and print their table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("variants", nargs="*", metavar="NAME[=VALUE]")
    parser.add_argument("--draw", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=sorted(DRAWS), default="anywhere")
    parser.add_argument("--duration", type=float, default=30.0)
    parser.add_argument("--plant", choices=PLANTS, default=PLANTS[0])
    parser.add_argument("--perturb", type=float, default=0.0)
    parser.add_argument("--jobs", type=int, default=cores())
    given = parser.parse_args()
    defaults = TimeOptimalSettings()
    try:
        wanted = [("", ""), *variants(given.variants, defaults)]
    except (ValueError, SyntaxError) as error:
        parser.error(str(error))
    limit_library_threads()  # for the processes, which inherit it
    conditions = StudyConditions(duration=given.duration, perturbation=given.perturb)
    conditions = conditions.with_settings([("simulator.plant", given.plant)])
    scenarios = draw_scenarios(given.draw, given.seed, given.kind)
    print(header(
        "number", "default", "value", "settled",
        "settling time over the default's: median / p90 / worst", "processor time a run [s]",
        "over the default's",
    ), flush=True)
    default: Vector | None = None
    for name, value in wanted:
        numbers = dataclasses.replace(defaults, **{name: value}) if name else defaults
        tasks = [(numbers, conditions, scenario) for scenario in scenarios]
        runs: Vector = np.array(in_processes(measured, tasks, given.jobs))
        default = runs if default is None else default
        known = getattr(defaults, name) if name else ""
        print(compared(name, known, value, runs, default), flush=True)


if __name__ == "__main__":
    main()
