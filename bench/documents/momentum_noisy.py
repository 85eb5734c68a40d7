# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Upright goals with slow, noisy and late poses of a sphere that is pushed, tilted or unbalanced.

``python bench/documents/momentum_noisy.py --runs 20`` prints a table: plant `rigid_body` with 3 %
wrong parameters, pose at 20 Hz, 5 mm and 1 degree of noise, 50 ms of latency, starts and goals
within 1.5 m of the origin, directions random, the push 0.5 to 3 s after the start. A run is judged
until the rotors cannot hold the momentum at its goal, at most for 20 s. It has settled at the time
from which on it stays within 3 cm and 3 degrees until then.
"""

import argparse
import math
from dataclasses import replace

import numpy as np
from noisy_poses import ANGLE_NOISE, MEASUREMENT, POSITION_NOISE
from tables import errors_in_words, header, last_arrival, median_and_worst, row

from sphere_nmpc.model.disturbance import momentum_of_push, rest_speeds
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.evaluation.metrics import angle_errors, position_errors
from sphere_sim.scenario.perturbation import DisturbanceDraws
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.motion import disturbance_of
from sphere_sim.study.single_run import prepare
from sphere_sim.world.disturbances import DisturbanceSettings

ROBOT = RobotParameters()
DURATION, OUTPUT_PERIOD = 20.0, 0.02
NEARER = 0.5
"""Factor on the positions of the scenarios, which are drawn within 3 m."""
HELD = 0.95
"""Share of the speed limit up to which the rotors count as able to hold the momentum; some is
needed for corrections."""
EARLY = 8.0
"""Time by which a run is to have settled [s]."""
LEAST_REST = 1.0
"""Time for which it has to stay settled [s]."""
PUSH, SLOPE, OFFSET = (0.5, 0.5), math.radians(0.3), 5e-4
DISTURBANCES = {
    "none": DisturbanceDraws(),
    "push of 0.5 N s": DisturbanceDraws(push=PUSH),
    "slope of 0.3°": DisturbanceDraws(slope=SLOPE),
    "centre of mass 0.5 mm off": DisturbanceDraws(offset=OFFSET),
    "all three": DisturbanceDraws(push=PUSH, slope=SLOPE, offset=OFFSET),
}


def scenarios(number: int, draws: DisturbanceDraws) -> list[Scenario]:
    """Return scenarios with upright goals, with what is drawn for them."""
    scale = np.ones(6)
    scale[POSITION] = NEARER
    return [
        draws.applied_to(replace(one, start=scale * one.start, goal=scale * one.goal))
        for one in draw_scenarios(number, 0, "upright")
    ]


def speeds_of_rest(scenario: Scenario, times: Vector, states: Vector) -> Vector:
    """Return the rotor speeds that hold the true momentum at the goal [rad/s], shape (n, 2)."""
    disturbance = disturbance_of(DisturbanceSettings(**scenario.disturbances), ROBOT)
    torques = np.array([disturbance.at_rest(state[QUATERNION]) for state in states])
    momenta = np.cumsum(torques, axis=0) * OUTPUT_PERIOD
    if scenario.push is not None:
        jump = momentum_of_push(ROBOT, np.array(scenario.push.impulse))
        momenta[times >= scenario.push.time] += jump
    goal = scenario.goal[QUATERNION]
    return np.array([rest_speeds(momentum, goal) for momentum in momenta])


def run(scenario: Scenario, momentum: bool) -> tuple[float, float, float, float]:
    """Run a scenario with or without the estimation of momentum.

    Returns the time until which the run is judged [s], the time at which it settled [s], inf if it
    did not, and the largest errors in the last `LEAST_REST` before the former [m, rad].
    """
    controller_settings = ControllerSettings(
        momentum=momentum, pose_position_noise=POSITION_NOISE, pose_orientation_noise=ANGLE_NOISE
    )
    conditions = StudyConditions(
        DURATION, 3.0, controller=controller_settings,
        simulator=replace(MEASUREMENT, plant="rigid_body"),
    )
    simulator, controller = prepare(conditions, scenario)
    found = run_closed_loop(
        simulator, controller, scenario.goal, DURATION, controller_settings.control_period,
        OUTPUT_PERIOD, push=scenario.push,
    )
    needed = np.max(np.abs(speeds_of_rest(scenario, found.times, found.states)), axis=1)
    held = needed < HELD * ROBOT.max_rotor_speed
    count = held.size if held.all() else int(np.argmin(held))
    times, states = found.times[:count], found.states[:count]
    judged, first = float(times[-1]), last_arrival(states, scenario.goal)
    rests = first < count and times[first] <= judged - LEAST_REST
    tail = states[times > judged - LEAST_REST]
    position, angle = (of(tail, scenario.goal) for of in (position_errors, angle_errors))
    return (
        judged, float(times[first]) if rests else math.inf,
        float(np.max(position)), float(np.max(angle)),
    )


def main() -> None:
    """Print the table, a row as soon as it is there."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=20)
    arguments = parser.parse_args()
    print(header("disturbance", "`momentum`", "judged until [s]", "settled", "by 8 s",
                 "after, median (worst) [s]", "largest error in the last second, median (worst)"))
    for name, draws in DISTURBANCES.items():
        drawn = scenarios(arguments.runs, draws)
        for momentum in (True, False):
            runs = np.array([run(scenario, momentum) for scenario in drawn])
            judged, settled = runs[:, 0], runs[np.isfinite(runs[:, 1]), 1]
            print(row(
                name, "on" if momentum else "off", f"{min(judged):.0f} to {max(judged):.0f}",
                f"{len(settled)} of {len(runs)}", np.sum(settled <= EARLY),
                median_and_worst(settled, ".1f"), errors_in_words(runs[:, 2], runs[:, 3]),
            ), flush=True)


if __name__ == "__main__":
    main()
