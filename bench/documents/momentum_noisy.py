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
from dataclasses import dataclass, field, replace

import numpy as np
from noisy_poses import ANGLE_NOISE, LATENCY, NEAR, NEAR_ANGLE, POSITION_NOISE, RATE

from sphere_nmpc.model.drift import (
    Drift,
    imbalance_of_offset,
    momentum_of_push,
    slope_torque,
)
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.evaluation.metrics import angle_errors, position_errors
from sphere_sim.scenario.perturbation import DisturbanceDraws
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import prepare
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.settings import SimulatorSettings

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


@dataclass(frozen=True)
class Disturbance:
    """What disturbs the runs of a row."""

    name: str
    draws: DisturbanceDraws = field(default_factory=DisturbanceDraws)


DISTURBANCES = (
    Disturbance("none"),
    Disturbance("push of 0.5 N s", DisturbanceDraws(push=PUSH)),
    Disturbance("slope of 0.3°", DisturbanceDraws(slope=SLOPE)),
    Disturbance("centre of mass 0.5 mm off", DisturbanceDraws(offset=OFFSET)),
    Disturbance("all three", DisturbanceDraws(push=PUSH, slope=SLOPE, offset=OFFSET)),
)


@dataclass(frozen=True)
class Outcome:
    """Result of a run.

    Attributes
    ----------
    judged : float
        Time until which it is judged [s].
    settled : float
        Time at which it settled [s]; inf if it did not.
    position, angle : float
        Largest errors in the last `LEAST_REST` before `judged` [m, rad].
    """

    judged: float
    settled: float
    position: float
    angle: float


def conditions(momentum: bool) -> StudyConditions:
    """Return the conditions of all runs."""
    controller = ControllerSettings(
        momentum=momentum, pose_position_noise=POSITION_NOISE, pose_orientation_noise=ANGLE_NOISE
    )
    simulator = SimulatorSettings(
        plant="rigid_body", position_noise=POSITION_NOISE, orientation_noise=ANGLE_NOISE,
        sensor_rate=RATE, sensor_latency=LATENCY,
    )
    return StudyConditions(DURATION, 3.0, controller=controller, simulator=simulator)


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
    settings = DisturbanceSettings(**scenario.disturbances)
    drift = Drift(
        slope=slope_torque(ROBOT, settings.slope, settings.slope_direction),
        imbalance=imbalance_of_offset(ROBOT, np.array(settings.mass_offset)),
    )
    torques = np.array([drift.torque_at_rest(state[QUATERNION]) for state in states])
    momenta = np.cumsum(torques, axis=0) * OUTPUT_PERIOD
    if scenario.push is not None:
        jump = momentum_of_push(ROBOT, np.array(scenario.push.impulse))
        momenta[times >= scenario.push.time] += jump
    goal = scenario.goal[QUATERNION]
    return np.array([Drift(momentum=momentum).rest_speeds(goal) for momentum in momenta])


def run(scenario: Scenario, momentum: bool) -> Outcome:
    """Run a scenario with or without the estimation of momentum."""
    settings = conditions(momentum)
    simulator, controller = prepare(settings, scenario)
    found = run_closed_loop(
        simulator, controller, scenario.goal, DURATION, settings.controller.control_period,
        OUTPUT_PERIOD, push=scenario.push,
    )
    needed = np.max(np.abs(speeds_of_rest(scenario, found.times, found.states)), axis=1)
    held = needed < HELD * ROBOT.max_rotor_speed
    count = held.size if held.all() else int(np.argmin(held))
    times, states = found.times[:count], found.states[:count]
    position = position_errors(states, scenario.goal)
    angle = angle_errors(states, scenario.goal)
    judged = float(times[-1])
    away = np.flatnonzero((position > NEAR) | (angle > NEAR_ANGLE))
    first = int(away[-1]) + 1 if away.size else 0
    rests = first < count and times[first] <= judged - LEAST_REST
    tail = times > judged - LEAST_REST
    return Outcome(
        judged, float(times[first]) if rests else math.inf,
        float(np.max(position[tail])), float(np.max(angle[tail])),
    )


def row(disturbance: Disturbance, momentum: bool, outcomes: list[Outcome]) -> str:
    """Return the row of a disturbance."""
    settled = [one.settled for one in outcomes if math.isfinite(one.settled)]
    early = sum(one <= EARLY for one in settled)
    times = f"{np.median(settled):.1f} ({max(settled):.1f})" if settled else "-"
    judged = [one.judged for one in outcomes]
    position = 100 * np.array([one.position for one in outcomes])
    angle = np.degrees([one.angle for one in outcomes])
    return (
        f"| {disturbance.name} | {'on' if momentum else 'off'} "
        f"| {min(judged):.0f} to {max(judged):.0f} | {len(settled)} of {len(outcomes)} | {early} "
        f"| {times} | {np.median(position):.1f} cm, {np.median(angle):.1f}° "
        f"({np.max(position):.1f} cm, {np.max(angle):.1f}°) |"
    )


def main() -> None:
    """Print the table, a row as soon as it is there."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=20)
    arguments = parser.parse_args()
    print("| disturbance | `momentum` | judged until [s] | settled | by 8 s "
          "| after, median (worst) [s] | largest error in the last second, median (worst) |")
    print("|---|---|---|---|---|---|---|")
    for disturbance in DISTURBANCES:
        drawn = scenarios(arguments.runs, disturbance.draws)
        for momentum in (True, False):
            outcomes = [run(scenario, momentum) for scenario in drawn]
            print(row(disturbance, momentum, outcomes), flush=True)


if __name__ == "__main__":
    main()
