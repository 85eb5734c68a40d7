# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""First plans of `time_optimal` by effort and by wall time: duration over the best known one.

    python bench/search_quality.py --draw 100 --json out/search_quality.json   # some minutes

One process plans from rest for random starts and goals. A row is a limit of the effort, or of the
wall time with an effort that is not reached; a plan that is not found counts as infinite.
"""

import argparse
import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
from node_runs import machine, write_json

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import without_momentum
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation, make_strategy
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study.best_known import best_known_times
from sphere_sim.study.motion import Motion
from sphere_sim.study.workers import Workers

_ENDLESS = 100_000_000
"""Effort that no wall time suffices for."""
_ROBOT = RobotParameters()


def first_plan(
    scenario: Scenario, effort: int, wall_time: float = np.inf
) -> tuple[float, float]:
    """Return the duration of the first plan [s], infinite without one, and its wall time [s]."""
    settings = dataclasses.replace(ControllerSettings(), planning_effort=effort)
    strategy = make_strategy(settings, _ROBOT)
    situation = Situation.of(
        0.0, without_momentum(scenario.start), scenario.goal, np.zeros(2), _ROBOT.lumped,
        time_budget=wall_time,
    )
    began = time.perf_counter()
    plan = strategy.plan(situation)
    took = time.perf_counter() - began
    return (float(plan.arrival) if np.isfinite(plan.arrival) else np.inf), took


def row(
    scenarios: list[Scenario], known: np.ndarray[Any, Any], effort: int, wall_time: float = np.inf
) -> dict[str, Any]:
    """Return the figures of one limit over all scenarios."""
    plans = np.array([first_plan(scenario, effort, wall_time) for scenario in scenarios])
    ratios = plans[:, 0] / known
    return {
        "effort": effort if effort < _ENDLESS else None,
        "limit_ms": 1e3 * wall_time if np.isfinite(wall_time) else None,
        "wall_time_ms": (1e3 * np.quantile(plans[:, 1], (0.5, 0.99))).tolist(),
        "ratio": np.quantile(ratios, (0.5, 0.9, 1.0), method="higher").tolist(),
    }


def main() -> None:
    """Measure all limits and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draw", type=int, default=100)
    parser.add_argument("--kind", default="anywhere")
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--bound-effort", type=float, default=1.0)
    parser.add_argument("--jobs", type=int, default=2, help="processes for best known times")
    parser.add_argument("--efforts", type=int, nargs="*", default=[5000, 15000, 50000, 150000])
    parser.add_argument("--wall-times", type=float, nargs="*", default=[10.0, 20.0, 50.0, 100.0],
                        help="[ms]")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    limit_library_threads()
    scenarios = draw_scenarios(options.draw, options.seed, options.kind)
    motions = [Motion(without_momentum(scenario.start), scenario.goal) for scenario in scenarios]
    with Workers(options.jobs) as workers:
        times = best_known_times(motions, _ROBOT, workers, options.bound_effort)
    known = np.array([found.duration for found in times])
    first_plan(scenarios[0], 20_000)  # loads the solver
    limits = [(effort, np.inf) for effort in options.efforts]
    limits += [(_ENDLESS, 1e-3 * limit) for limit in options.wall_times]
    print("effort    limit [ms]  wall time [ms] p50 p99   ratio p50 p90 max")
    rows = []
    for effort, wall_time in limits:
        rows.append(found := row(scenarios, known, effort, wall_time))
        (median, p99), (middle, p90, most) = found["wall_time_ms"], found["ratio"]
        print(f"{found['effort'] or '-':>8}  {found['limit_ms'] or 0.0:10.0f}  "
              f"{median:18.1f} {p99:5.1f}  {middle:9.3f} {p90:.3f} {most:.3f}", flush=True)
    write_json(options.json, {"machine": machine(), "options": vars(options) | {"json": None},
                         "rows": rows})


if __name__ == "__main__":
    main()
