# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals that each strategy reaches with robots from 3 cm to 1 m, drawn at random.

Prints a table, robot by robot:

    python bench/documents/strategies_of_robots.py --robots 12 --goals 20 --seed 1
"""

import argparse

import numpy as np
from other_robots import ROBOTS, scaled
from tables import header, in_processes, row

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.units import RobotUnits
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import run_scenario
from sphere_sim.world.settings import SimulatorSettings

_DURATION = 40.0
"""Length of a run [s] with the robot of Table 1. For another it is that in the time of the robot,
and longer by the root of the ratio of radii for a smaller one, to which the goals are farther
away: half as long again as the slowest runs."""


def drawn(seed: int) -> RobotParameters:
    """Return a random robot.

    Radius 3 cm to 1 m, mass 33 to 170 kg/m^2 of the radius squared, 30 to 80 % of it in rotors
    and counterweights, rim speed of a rotor's speed at the shell 15 to 60 m/s, ramp to it in 0.05
    to 1.5 s; all log-uniform but the share. Rotors have gyration radii of 0.25 to 0.4 radii, 0.35
    to 0.6 radii off the centre.
    """
    rng = np.random.default_rng([7, seed])

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    radius = between(0.03, 1.0)
    mass, share = between(33.0, 170.0) * radius**2, float(rng.uniform(0.3, 0.8))
    gyration, offset = rng.uniform(0.25, 0.4) * radius, rng.uniform(0.35, 0.6) * radius
    speed, rotor = between(15.0, 60.0) / radius, share * mass / 4.0
    return scaled(
        radius, (1.0 - share) * mass, rotor, speed, speed / between(0.05, 1.5),
        axial=float(rotor * gyration**2), offset=float(offset),
    )


def settled(robot: RobotParameters, strategy: str, plant: str, scenario: Scenario) -> bool:
    """Return whether a run has settled."""
    units = RobotUnits.of(robot)
    conditions = StudyConditions(
        duration=_DURATION * units.time * max(1.0, units.length**-0.5),
        controller=ControllerSettings(strategy=strategy), robot=robot,
        simulator=SimulatorSettings(plant=plant),
    )
    return bool(run_scenario(conditions, scenario).results["settled"])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--robots", type=int, default=12)
    parser.add_argument("--goals", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--plant", default="rolling")
    given = parser.parse_args()
    goals = draw_scenarios(given.goals, given.seed)
    robots = {name: robot for name, robot in ROBOTS.items() if robot != RobotParameters()}
    robots |= {str(n + 1): drawn(given.seed + n) for n in range(given.robots)}
    print(header(
        "robot", "radius [m]", "largest speed [rad/s]", "ramp to it [s]", "T of `paper` [s]",
        *(f"`{name}`" for name in STRATEGIES),
    ))
    for name, robot in robots.items():
        reached = np.array(in_processes(settled, [
            (robot, strategy, given.plant, goal) for strategy in STRATEGIES for goal in goals
        ])).reshape(len(STRATEGIES), -1)
        speed = robot.max_rotor_speed
        period = ControllerSettings(strategy="paper").of(robot).period
        print(row(
            name, f"{robot.shell_radius:.3f}", f"{speed:.0f}",
            f"{speed / robot.max_rotor_acceleration:.2f}", f"{period:g}",
            *(f"{found} of {given.goals}" for found in reached.sum(axis=1)),
        ), flush=True)


if __name__ == "__main__":
    main()
