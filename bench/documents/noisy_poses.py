# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The paper's cases with slow, noisy, late and lost poses, with and without state estimator.

``python bench/documents/noisy_poses.py --seeds 4`` prints a table for docs/rigid_body.md:
pose at 20 Hz, 5 mm and 1 degree of noise, 50 ms of latency, 20 % lost. A run has arrived at the
time from which on it stays within 3 cm and 3 degrees to its end.
"""

import argparse
import math
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.evaluation.metrics import angle_errors, position_errors
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

POSITION_NOISE, ANGLE_NOISE = 0.005, math.radians(1.0)
RATE, LATENCY, LOST = 20.0, 0.05, 0.2
NEAR, NEAR_ANGLE = 0.03, math.radians(3.0)
WAYS = (("time_optimal", 0.5), ("paper", 0.5), ("paper", 5.0))
"""Strategies with the input weight alpha; a larger weight reacts less to noise."""
TAIL = 10.0
"""Length of the end of a run over which its largest errors are reported [s]."""


@dataclass(frozen=True)
class Outcome:
    """Arrival time of a run [s], inf if never, and its errors at the end [m, rad]."""

    arrived: float
    position: float
    angle: float


def run(
    plant: str, way: tuple[str, float], case: int, seed: int, fused: bool, duration: float
) -> Outcome:
    """Run a case of the paper."""
    scenario, robot = PAPER_CASES[case], RobotParameters()
    world = SimulatorSettings(
        plant=plant, initial_state=tuple(float(v) for v in scenario.start), seed=seed,
        position_noise=POSITION_NOISE, orientation_noise=ANGLE_NOISE,
        sensor_rate=RATE, sensor_latency=LATENCY, sensor_dropout=LOST,
    )
    settings = ControllerSettings(
        strategy=way[0], input_weight=way[1],
        pose_position_noise=POSITION_NOISE if fused else 0.0,
        pose_orientation_noise=ANGLE_NOISE if fused else 0.0,
    )
    found = run_closed_loop(
        Simulator(world, robot), Controller(settings, robot), scenario.goal, duration,
        settings.control_period, 0.02,
    )
    position = position_errors(found.states, scenario.goal)
    angle = angle_errors(found.states, scenario.goal)
    away = np.flatnonzero((position > NEAR) | (angle > NEAR_ANGLE))
    first = int(away[-1]) + 1 if away.size else 0
    arrived = float(found.times[first]) if first < len(found.times) else math.inf
    tail = found.times > duration - TAIL
    return Outcome(arrived, float(np.max(position[tail])), float(np.max(angle[tail])))


def main() -> None:
    """Print a row for each plant and strategy, with and without the state estimator."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--duration", type=float, default=30.0)
    parser.add_argument("--plants", nargs="+", default=["rolling", "rigid_body"])
    arguments = parser.parse_args()
    print("| plant | strategy | poses | arrived at the end | from, median (worst) [s] "
          "| largest error in the last 10 s, median (worst) |")
    print("|---|---|---|---|---|---|")
    for plant in arguments.plants:
        for way in WAYS:
            for fused in (True, False):
                runs = [
                    run(plant, way, case, seed, fused, arguments.duration)
                    for seed in range(1, arguments.seeds + 1) for case in PAPER_CASES
                ]
                print(_row(plant, way, fused, runs, arguments.duration - TAIL), flush=True)


def _row(
    plant: str, way: tuple[str, float], fused: bool, runs: list[Outcome], latest: float
) -> str:
    # An arrival just before the end does not show that the sphere stays there.
    arrived = [found.arrived for found in runs if found.arrived <= latest]
    times = f"{np.median(arrived):.1f} ({max(arrived):.1f})" if arrived else "-"
    position = np.array([found.position for found in runs])
    angle = np.degrees([found.angle for found in runs])
    name = way[0] if way[0] == "time_optimal" else f"{way[0]}, α = {way[1]:g}"
    return (
        f"| {plant} | {name} | {'fused' if fused else 'trusted'} | {len(arrived)} of {len(runs)} "
        f"| {times} | {100 * np.median(position):.1f} cm, {np.median(angle):.1f}° "
        f"({100 * np.max(position):.1f} cm, {np.max(angle):.1f}°) |"
    )


if __name__ == "__main__":
    main()
