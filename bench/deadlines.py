# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Missed sampling instants on runs to drawn goals, one after another, through the nodes.

    python bench/deadlines.py --draw 20 --seed 1
    python bench/deadlines.py --draw 20 --seed 1 --clock system

Each run starts where the one before ended, at rest. A miss is a sampling instant at which no
command was sent, as planning took longer or other processes had the processor.
"""

import argparse
import math
from pathlib import Path

import numpy as np
from machine import machine, write_json
from node_runs import PATIENCE, Observer, running

from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import STRATEGIES
from sphere_sim.ros.simulator.settings import CLOCKS
from sphere_sim.scenario.scenarios import draw_scenarios

_HEADER = "run  misses  first plan ms  longest plan ms  settled after s  final error"


def one_run(observer: Observer, goal: Vector, longest: float) -> dict[str, float]:
    """Run to a goal and return the figures of the run."""
    statuses = observer.record.statuses
    missed, first = int(statuses[-1]["missed_ticks"]), len(statuses)
    settled = observer.goals.go(goal, longest, PATIENCE)
    plans = [
        1e3 * float(status["solve_time_s"])
        for status in statuses[first:] if status["mode"] == "on the way to the goal"
    ]
    return {
        "misses": int(statuses[-1]["missed_ticks"]) - missed,
        "first_plan_ms": plans[0] if plans else math.nan,
        "longest_plan_ms": max(plans, default=math.nan),
        "settled_s": math.nan if settled is None else settled,
        "final_error": math.nan if observer.goals.run is None else observer.goals.run.error,
    }


def main() -> int:
    """Make the runs, print a line each and a summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draw", type=int, default=20, help="number of goals")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--strategy", choices=STRATEGIES, default="time_optimal")
    parser.add_argument("--rtf", type=float, default=1.0, help="real-time factor")
    parser.add_argument("--clock", choices=CLOCKS, default="simulated", help="of both nodes")
    parser.add_argument("--longest", type=float, default=40.0, help="time for a run [s]")
    parser.add_argument("--json", type=Path, help="file for the results")
    options = parser.parse_args()
    scenarios = draw_scenarios(options.draw, options.seed)
    about = machine()
    start = ", ".join(repr(float(value)) for value in scenarios[0].start)
    simulator = {
        "initial_state": f"[{start}]", "real_time_factor": options.rtf, "clock": options.clock
    }
    runs = []
    print(f"{about['date']}, load {about['load_average']}\n{_HEADER}")
    with running(simulator, {"strategy": options.strategy}) as observer:
        observer.begin()
        for number, scenario in enumerate(scenarios):
            run = one_run(observer, scenario.goal, options.longest)
            runs.append(run)
            print(
                f"{number:3d}  {run['misses']:6d}  {run['first_plan_ms']:13.1f}"
                f"  {run['longest_plan_ms']:15.1f}  {run['settled_s']:15.2f}"
                f"  {run['final_error']:11.2e}",
                flush=True,
            )
    settled = np.array([run["settled_s"] for run in runs])
    summary = {
        "runs": len(runs),
        "settled": int(np.sum(np.isfinite(settled))),
        "misses": int(sum(run["misses"] for run in runs)),
        "settled_s_median": float(np.nanmedian(settled)),
        "first_plan_ms_max": float(np.nanmax([run["first_plan_ms"] for run in runs])),
        "longest_plan_ms": float(np.nanmax([run["longest_plan_ms"] for run in runs])),
        "load_average_after": machine()["load_average"],
    }
    print(summary)
    write_json(options.json, {"machine": about, "summary": summary, "runs": runs})
    return 0 if summary["misses"] == 0 and summary["settled"] == len(runs) else 1


if __name__ == "__main__":
    raise SystemExit(main())
