# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals that leave something free, and the arrival that is told, in the ideal closed loop.

    python bench/goal_figures.py --draw 100 --json out/goal_figures.json   # some minutes

For each kind of goal: the settling time over that of the best known motion to the set, and over
the settling time of the full pose; and by how much the arrival that is told at each instant
differs from the settling time.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from node_runs import machine, write_json
from rich.progress import track

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, without_momentum
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.evaluation.metrics import settling_index, state_errors
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study.best_known import best_known_times
from sphere_sim.study.motion import Motion
from sphere_sim.study.workers import Workers
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

_ROBOT = RobotParameters()
_SETTINGS = ControllerSettings()
_DURATION = 20.0
"""Duration of a run [s]."""


def run(scenario: Scenario, kind: Orientation) -> tuple[float, list[float]]:
    """Return the settling time [s] and the errors of the arrivals that were told [s]."""
    plant = make_plant("rolling", _ROBOT, scenario.start)
    simulator = Simulator(
        SimulatorSettings(initial_state=tuple(scenario.start)), _ROBOT, plant
    )
    controller = Controller(_SETTINGS, _ROBOT)
    found = run_closed_loop(
        simulator, controller, Goal(scenario.goal, kind), _DURATION, _SETTINGS.control_period
    )
    members = kind.nearest_of(scenario.goal, found.states)
    index = settling_index(state_errors(found.states, members))
    settled = np.inf if index is None else float(found.times[index])
    return settled, _told(found, settled)


def _told(run: Trajectory, settled: float) -> list[float]:
    """Return the differences of the arrivals that were told from the settling time [s]."""
    plans = [one.plan for one in run.decisions if one.mode is Kind.TRACKING]
    return [plan.arrival - settled for plan in plans if np.isfinite(plan.arrival)]


def best_known(scenarios: list[Scenario], kind: Orientation, jobs: int) -> Vector:
    """Return the settling times of the best known motions to a set [s]."""
    motions = [
        Motion(without_momentum(one.start), one.goal, orientation=kind) for one in scenarios
    ]
    with Workers(jobs) as workers:
        return np.array([
            found.settling for found in best_known_times(motions, _ROBOT, workers)
        ])


def main() -> None:
    """Measure all kinds and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draw", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", default="anywhere")
    parser.add_argument("--jobs", type=int, default=2, help="processes for best known times")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    limit_library_threads()
    scenarios = draw_scenarios(options.draw, options.seed, options.kind)
    rows: dict[str, Any] = {}
    full: Vector = np.empty(0)
    for kind in Orientation:
        known = best_known(scenarios, kind, options.jobs)
        runs = [run(one, kind) for one in track(scenarios, description=kind.value)]
        settling = np.array([settled for settled, _ in runs])
        full = settling if kind is Orientation.FULL else full
        told = np.abs(np.concatenate([errors for _, errors in runs]))
        rows[kind.value] = found = {
            "settled": int(np.isfinite(settling).sum()),
            "over_best_known": np.quantile(settling / known, (0.5, 0.9, 1.0)).tolist(),
            "over_full_pose": np.quantile(settling / full, (0.5, 0.9, 1.0)).tolist(),
            "arrival_told_s": np.quantile(told, (0.5, 0.95, 0.99)).tolist(),
        }
        print(f"{kind.value:12} settled {found['settled']} of {len(scenarios)}", end="")
        for name in ("over_best_known", "over_full_pose", "arrival_told_s"):
            print(f"   {name} " + " ".join(f"{value:.3f}" for value in found[name]), end="")
        print(flush=True)
    told_of = vars(options) | {"json": None}
    write_json(options.json, {"machine": machine(), "options": told_of, "rows": rows})


if __name__ == "__main__":
    main()
