# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Ablation of the strategy `time_optimal`: what each number of its settings is worth.

    python bench/documents/ablation.py --out out/ablation --draw 200
    python bench/documents/ablation.py least_dead_band slew_weight=20 --out out/some
    python bench/documents/ablation.py --plant rigid_body --perturb 10 --out out/contact

Each number is halved and doubled, or set to a given value, and the same scenarios are run as with
the default settings. Settling times are compared run by run. What is chance shows in a slight
change of a number of the search, which leads to other guesses. Without names all numbers are
varied. A file for each variant is kept in the folder: the same command continues from there.
``table.md`` has the table that is printed.
"""

import argparse
import ast
import dataclasses
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from sphere_nmpc.control import controller
from sphere_nmpc.library_threads import limit_library_threads
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy
from sphere_sim.output.files import write_atomically
from sphere_sim.scenario.scenarios import DRAWS, Scenario, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.journal import fingerprint
from sphere_sim.study.progress import shown
from sphere_sim.study.single_run import run_scenario
from sphere_sim.study.workers import Workers, cores
from sphere_sim.world.settings import PLANTS

DEFAULT = TimeOptimalSettings()
COLUMNS = (
    "number", "default", "value", "settled",
    "settling time over the default's: median / p90 / worst", "processor time a run [s]",
    "over the default's",
)
HEADER = "| " + " | ".join(COLUMNS) + " |\n" + len(COLUMNS) * "|---" + "|"


@dataclass(frozen=True)
class Variant:
    """Settings of which one number differs from the default; none for the default itself."""

    name: str = ""
    value: Any = None

    @property
    def file(self) -> str:
        """Name of the file of its runs."""
        return f"{self.name}={_text(self.value)}.json" if self.name else "default.json"

    @property
    def tuning(self) -> TimeOptimalSettings:
        return replace(DEFAULT, **{self.name: self.value}) if self.name else DEFAULT


@dataclass(frozen=True)
class Run:
    """Settling time of a run [s], None where it did not settle, and its processor time [s]."""

    settled_after: float | None
    computed: float


def variants(words: Sequence[str]) -> list[Variant]:
    """Return the variants that words ask for: ``name`` or ``name=value``; all without words.

    Raises
    ------
    ValueError
        If there is no such number, or the value is not of its type.
    """
    known: dict[str, Any] = {field.name: field.default for field in dataclasses.fields(DEFAULT)}
    found = []
    for word in words or [name for name, value in known.items() if _is_number(value)]:
        name, has_value, text = word.partition("=")
        if name not in known:
            raise ValueError(f"{name}: no field of TimeOptimalSettings")
        default = known[name]
        if has_value:
            value = ast.literal_eval(text)
            value = float(value) if isinstance(default, float) else value
            if type(value) is not type(default):
                raise ValueError(f"{name}: given {text}, expected {type(default).__name__}")
            found.append(Variant(name, value))
        elif _is_number(default):
            scaled = [type(default)(factor * default) for factor in (0.5, 2)]
            found += [Variant(name, value) for value in scaled if value != default]
        else:
            raise ValueError(f"{name}: not a number, give a value as {name}={_text(default)}")
    return list(dict.fromkeys(found))


def _is_number(value: Any) -> bool:
    return type(value) in (int, float)


def _text(value: Any) -> str:
    return ",".join(f"{v:g}" for v in value) if isinstance(value, tuple) else f"{value:g}"


def measured(tuning: TimeOptimalSettings, conditions: StudyConditions, scenario: Scenario) -> Run:
    """Make a run with other settings of the strategy; called in the workers."""

    def tuned(settings: ControllerSettings, robot: RobotParameters) -> TimeOptimalStrategy:
        return TimeOptimalStrategy(settings, robot, tuning)

    _load(conditions, scenario)
    with patch.object(controller, "make_strategy", tuned):
        began = time.process_time()
        record = run_scenario(conditions, scenario)
        computed = time.process_time() - began
    found = record.results.get("settle_time_s")
    return Run(found if isinstance(found, float) else None, computed)


@cache
def _load(conditions: StudyConditions, scenario: Scenario) -> None:
    """Load what a process loads with its first run, which is not part of a measurement."""
    if not _load.cache_info().currsize:
        run_scenario(replace(conditions, duration=0.5), scenario)


def row(variant: Variant, runs: Sequence[Run], default: Sequence[Run]) -> str:
    """Return a row of the table."""
    after, before = _settled_after(runs), _settled_after(default)
    compared = np.isfinite(after) & (before > 0.0)
    ratios = after[compared] / before[compared]
    spread = "-"
    if ratios.size:
        median, p90 = np.percentile(ratios, [50, 90])
        spread = f"{median:.3f} / {p90:.3f} / {ratios.max():.3f}"
    spent, spent_before = (float(np.mean([r.computed for r in of])) for of in (runs, default))
    cells = (
        f"`{variant.name}`" if variant.name else "none",
        _text(getattr(DEFAULT, variant.name)) if variant.name else "",
        _text(variant.value) if variant.name else "",
        f"{np.isfinite(after).sum()} of {len(runs)}", spread,
        f"{spent:.2f}", f"{spent / spent_before:.2f}",
    )
    return "| " + " | ".join(cells) + " |"


def _settled_after(runs: Sequence[Run]) -> Vector:
    return np.array(
        [np.nan if run.settled_after is None else run.settled_after for run in runs]
    )


def kept_runs(path: Path, about: Any) -> list[Run] | None:
    """Return the runs of a file, None where there is none.

    Raises
    ------
    ValueError
        If the file has runs of other settings, scenarios or code.
    """
    if not path.exists():
        return None
    content = json.loads(path.read_text(encoding="utf-8"))
    if content["about"] != about:
        raise ValueError(f"{path}: of other settings, scenarios or code; choose another folder")
    return [Run(**run) for run in content["runs"]]


def main() -> None:
    """Make the runs of all variants and print their table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("variants", nargs="*", metavar="NAME[=VALUE]")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--draw", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=sorted(DRAWS), default="anywhere")
    parser.add_argument("--duration", type=float, default=30.0)
    parser.add_argument("--plant", choices=PLANTS, default=PLANTS[0])
    parser.add_argument("--perturb", type=float, default=0.0)
    parser.add_argument("--jobs", type=int, default=cores())
    given = parser.parse_args()
    limit_library_threads()  # for the processes, which inherit it
    conditions = StudyConditions(duration=given.duration, perturbation=given.perturb)
    conditions = conditions.with_settings([("simulator.plant", given.plant)])
    scenarios = draw_scenarios(given.draw, given.seed, given.kind)
    about = fingerprint(conditions, scenarios)
    try:
        wanted = [Variant(), *variants(given.variants)]
        done = {variant: kept_runs(given.out / variant.file, about) for variant in wanted}
    except (ValueError, SyntaxError) as error:
        parser.error(str(error))
    given.out.mkdir(parents=True, exist_ok=True)
    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
        TextColumn("runs, to go"), TimeRemainingColumn(),
        console=Console(stderr=True), transient=True,
    )
    missing = sum(given.draw for runs in done.values() if runs is None)
    lines, default = [HEADER], list[Run]()
    with Workers(given.jobs) as workers, shown(bar) as progress:
        task = progress.add_task("", total=missing)
        print(HEADER, flush=True)
        for variant in wanted:
            runs = done[variant]
            if runs is None:
                progress.update(task, description=variant.file.removesuffix(".json"))
                tasks = [(i, (variant.tuning, conditions, s)) for i, s in enumerate(scenarios)]
                found = {}
                for index, run in workers.run(measured, tasks, "run"):
                    found[index] = run
                    progress.advance(task)
                runs = [found[index] for index in range(len(scenarios))]
                content = {"about": about, "runs": [asdict(run) for run in runs]}
                write_atomically(given.out / variant.file, json.dumps(content).encode())
            default = default or runs
            lines.append(row(variant, runs, default))
            print(lines[-1], flush=True)
            write_atomically(given.out / "table.md", ("\n".join(lines) + "\n").encode())


if __name__ == "__main__":
    main()
