# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The paper's cases with slow, noisy, late and lost poses, with and without state estimator.

``python bench/documents/noisy_poses.py --seeds 4`` prints a table for docs/rigid_body.md:
pose at 20 Hz, 5 mm and 1 degree of noise, 50 ms of latency, 20 % lost. A run has arrived at the
time from which on it stays within 3 cm and 3 degrees to its end.
"""

import argparse
import itertools
import math
from dataclasses import replace

import numpy as np
from tables import errors_in_words, header, last_arrival, median_and_worst, row

from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.evaluation.metrics import angle_errors, position_errors
from sphere_sim.scenario.scenarios import PAPER_CASES, Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import prepare
from sphere_sim.world.settings import SimulatorSettings

POSITION_NOISE, ANGLE_NOISE = 0.005, math.radians(1.0)
MEASUREMENT = SimulatorSettings(
    position_noise=POSITION_NOISE, orientation_noise=ANGLE_NOISE, sensor_rate=20.0,
    sensor_latency=0.05,
)
LOST = 0.2
WAYS = (("time_optimal", 0.5), ("paper", 0.5), ("paper", 5.0))
"""Strategies with the input weight alpha; a larger weight reacts less to noise."""
TAIL = 10.0
"""Length of the end of a run over which its largest errors are reported [s]."""


def run(conditions: StudyConditions, scenario: Scenario) -> tuple[float, float, float]:
    """Return when a run arrives [s], inf if never, and its largest errors at the end [m, rad]."""
    simulator, controller = prepare(conditions, scenario)
    found = run_closed_loop(
        simulator, controller, scenario.goal, conditions.duration,
        conditions.controller.control_period, 0.02,
    )
    first = last_arrival(found.states, scenario.goal)
    arrived = float(found.times[first]) if first < len(found.times) else math.inf
    tail = found.states[found.times > conditions.duration - TAIL]
    position, angle = (of(tail, scenario.goal) for of in (position_errors, angle_errors))
    return arrived, float(np.max(position)), float(np.max(angle))


def main() -> None:
    """Print a row for each plant and strategy, with and without the state estimator."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--duration", type=float, default=30.0)
    parser.add_argument("--plants", nargs="+", default=["rolling", "rigid_body"])
    given = parser.parse_args()
    print(header("plant", "strategy", "poses", "arrived at the end", "from, median (worst) [s]",
                 "largest error in the last 10 s, median (worst)"))
    scenarios = [replace(paper, seed=seed) for seed in range(1, given.seeds + 1)
                 for paper in PAPER_CASES.values()]
    for plant, (strategy, weight), fused in itertools.product(
        given.plants, WAYS, (True, False)
    ):
        controller = ControllerSettings(
            strategy=strategy, input_weight=weight,
            pose_position_noise=POSITION_NOISE if fused else 0.0,
            pose_orientation_noise=ANGLE_NOISE if fused else 0.0,
        )
        simulator = replace(MEASUREMENT, plant=plant, sensor_dropout=LOST)
        conditions = StudyConditions(given.duration, controller=controller, simulator=simulator)
        runs = np.array([run(conditions, scenario) for scenario in scenarios])
        # An arrival just before the end does not show that the sphere stays there.
        arrived = runs[runs[:, 0] <= given.duration - TAIL, 0]
        print(row(
            plant, strategy if strategy == "time_optimal" else f"{strategy}, α = {weight:g}",
            "fused" if fused else "trusted", f"{len(arrived)} of {len(runs)}",
            median_and_worst(arrived, ".1f"), errors_in_words(runs[:, 1], runs[:, 2]),
        ), flush=True)


if __name__ == "__main__":
    main()
