# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Front of the motors' heat against time: closed loops by `time_margin`.

    python bench/effort.py --draw 40                                  # three minutes
    python bench/effort.py --draw 8 --kind far --duration 120

Each goal is run with each margin. Settling times are those over the best known motion, heat and
energy those over the run without a margin; a run that does not settle counts as infinite.
"""

import argparse
from dataclasses import replace

import numpy as np
from rich.progress import track

from sphere_nmpc.model.state import without_momentum
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.best_known import best_known_time
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.motion import Motion
from sphere_sim.study.single_run import run_scenario

_FIGURES = "settle_time_s", "heat", "energy_j"


def main() -> None:
    """Run all margins and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draw", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", default="anywhere")
    parser.add_argument("--duration", type=float, default=20.0, help="of a run [s]")
    parser.add_argument("--margins", type=float, nargs="*", default=[0.05, 0.1, 0.2, 0.5, 1.0])
    options = parser.parse_args()
    limit_library_threads()
    conditions = StudyConditions(duration=options.duration)
    scenarios = draw_scenarios(options.draw, options.seed, options.kind)
    motions = [Motion(without_momentum(one.start), one.goal) for one in scenarios]
    known = [best_known_time(one, conditions.robot).settling for one in track(motions, "best")]
    over = np.column_stack((known, np.ones((len(known), 2))))
    print("margin  median and worst ratio of settling time, heat, energy")
    for margin in (0.0, *options.margins):
        controller = replace(conditions.controller, time_margin=margin)
        records = [
            run_scenario(replace(conditions, controller=controller), one)
            for one in track(scenarios, f"margin {margin:g}", transient=True)
        ]
        found = np.array([
            [one.results.get(name) or np.inf for name in _FIGURES] for one in records
        ], dtype=float)
        if margin == 0.0:
            over[:, 1:] = found[:, 1:]
        ratios = np.quantile(found / over, (0.5, 1.0), axis=0).T.ravel()
        print(f"{margin:6.2f}  " + " ".join(f"{ratio:.3f}" for ratio in ratios), flush=True)


if __name__ == "__main__":
    main()
