# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of plans and runs over the best known motions, for docs/strategy.md.

    python bench/documents/search_tables.py plans --runs 60 --jobs 1    # some minutes
    python bench/documents/search_tables.py goals --runs 40 --seed 2

`plans` are first plans of `time_optimal` from rest, by a limit of the effort, or of the wall time
with an effort that is not reached; one that is not found counts as infinite. `goals` leave
something free: settling times in the ideal closed loop, also over those of the full pose, and by
how much the arrival that is reported at each instant differs from them.
"""

import time
from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np
from tables import Row, Table, drawn, print_tables

from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, without_momentum
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation, make_strategy
from sphere_sim.scenario.scenarios import PAPER_CASES, Scenario
from sphere_sim.study.best_known import BestKnownTimes, best_known_times
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.motion import Motion
from sphere_sim.study.single_run import closed_loop
from sphere_sim.study.workers import Workers, cores

_ENDLESS = 100_000_000
"""Effort that no wall time suffices for."""
_ROBOT = RobotParameters()
_CONDITIONS = StudyConditions(20.0)
_SHARES = (0.5, 0.9, 1.0)


def _known(scenarios: list[Scenario], orientation: Orientation) -> list[BestKnownTimes]:
    motions = [
        Motion(without_momentum(one.start), one.goal, orientation=orientation)
        for one in scenarios
    ]
    with Workers(cores()) as workers:
        return best_known_times(motions, _ROBOT, workers)


def _spread(values: Vector, shares: tuple[float, ...] = _SHARES, method: Any = "linear") -> str:
    return " ".join(f"{one:.3f}" for one in np.quantile(values, shares, method=method))


def _of_plans(number: int, seed: int, kind: str) -> Iterator[Row]:
    scenarios = drawn(_CONDITIONS, number, seed, kind)
    known = [one.duration for one in _known(scenarios, Orientation.FULL)]
    limits = [(f"effort {effort}", effort, np.inf) for effort in (5000, 15000, 50000, 150000)]
    limits += [(f"{ms} ms", _ENDLESS, 1e-3 * ms) for ms in (10, 20, 50, 100)]
    for name, effort, wall_time in limits:
        yield Row((name,), [
            (one, effort, wall_time, best) for one, best in zip(scenarios, known, strict=True)
        ])


def _first_plan(
    scenario: Scenario, effort: int, wall_time: float, known: float
) -> tuple[float, float]:
    """Return wall time [ms] and duration, over the best known one, of the first plan."""
    _load()
    began = time.perf_counter()
    plan = _planned(scenario, effort, wall_time)
    took = 1e3 * (time.perf_counter() - began)
    return took, plan.arrival / known if np.isfinite(plan.arrival) else np.inf


def _planned(scenario: Scenario, effort: int, wall_time: float) -> Any:
    strategy = make_strategy(ControllerSettings(planning_effort=effort), _ROBOT)
    start = without_momentum(scenario.start)
    return strategy.plan(Situation.of(
        0.0, start, scenario.goal, np.zeros(2), _ROBOT.lumped, time_budget=wall_time
    ))


@cache
def _load() -> None:
    """Load what a process loads with its first plan."""
    _planned(PAPER_CASES[1], 20_000, np.inf)


def _cells_of_plans(found: list[Any], _: object) -> list[str]:
    took, ratios = np.array(found).T
    median, most = np.quantile(took, (0.5, 0.99))
    return [f"{median:.1f} {most:.1f}", _spread(ratios, method="higher")]


def _of_goals(number: int, seed: int) -> Iterator[Row]:
    scenarios = drawn(_CONDITIONS, number, seed)
    for kind in Orientation:
        pairs = zip(scenarios, _known(scenarios, kind), strict=True)
        yield Row((kind.value,), [(one, kind, best.settling) for one, best in pairs])


def _settling(
    scenario: Scenario, kind: Orientation, known: float
) -> tuple[float, float, list[float]]:
    """Return the settling time [s], also over the best known one, and errors of arrivals [s]."""
    goal = Goal(scenario.goal, kind)
    found = closed_loop(_CONDITIONS, scenario, goal=goal)
    settled = float(np.nan_to_num(found.settled_after, nan=np.inf))
    plans = [one.plan for one in found.decisions if one.mode is Kind.TRACKING]
    arrivals = [plan.arrival - settled for plan in plans if np.isfinite(plan.arrival)]
    return settled, settled / known, arrivals


def _cells_of_goals(found: list[Any], full: list[Any]) -> list[str]:
    settling, full_pose = (np.array([run[0] for run in runs]) for runs in (found, full))
    errors = np.abs(np.concatenate([run[2] for run in found]))
    return [
        f"{np.isfinite(settling).sum()} of {len(found)}", _spread(np.array([r[1] for r in found])),
        _spread(settling / full_pose), _spread(errors, (0.5, 0.95, 0.99)),
    ]


_OF_PLANS = ("limit", "wall time [ms]: median, p99", "ratio: median, p90, worst")
_PLANS = Table(_OF_PLANS, partial(_of_plans, kind="anywhere"), _first_plan, _cells_of_plans,
               number=100, seed=5)
TABLES = {
    "plans": _PLANS, "far_plans": _PLANS._replace(rows=partial(_of_plans, kind="far")),
    "goals": Table(
        ("goal", "settled", "over the best known motion: median, p90, worst",
         "over the full pose", "arrival off by, median, p95, p99 [s]"),
        _of_goals, _settling, _cells_of_goals, number=100, has_reference=True,
    ),
}

if __name__ == "__main__":
    print_tables(TABLES, __doc__)
