# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Deviation of the model with momentum and of the paper's model from plants with disturbances.

``python bench/documents/momentum_figures.py --runs 100`` prints a table: random runs of 3 s from
random orientations, rotor speeds uniform in +-60 rad/s each half second and joined by straight
lines, directions random. A deviation is the largest within a run, evaluated every 10 ms. The plant
with contact has a stiff contact and ideal drives.
"""

import argparse
import math
from itertools import pairwise
from typing import Any

import numpy as np
from plant_runs import STEP, deviation, ramped
from tables import header, row

from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance, momentum_of_push
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import MOMENTUM, NO_MOMENTUM, Vector, without_momentum
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.scenario.perturbation import DisturbanceDraws
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study.motion import disturbance_of
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.contract import Plant
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
CONTACT = RigidBodySettings(
    drive_bandwidth=1e6, drive_feedforward=True, torque_limit=1e3, friction=2.0,
    time_step=5e-4, contact_time_constant=1e-3,
)
SPEED, KNOTS, PUSH_TIME = 60.0, 6, 1.0
PUSH_STEP = round(PUSH_TIME / STEP)


def draws(push: float = 0.0, slope: float = 0.0, offset: float = 0.0) -> DisturbanceDraws:
    """Return draws of a push [N s], a slope [degree] and an offset [mm]."""
    impulses = (push, push) if push else None
    return DisturbanceDraws(impulses, PUSH_TIME, math.radians(slope), 1e-3 * offset)


DISTURBANCES = {
    "none": draws(),
    "push of 1 N s after 1 s": draws(push=1.0),
    "slope of 1°": draws(slope=1.0),
    "centre of mass 1 mm off": draws(offset=1.0),
    "centre of mass 3 mm off": draws(offset=3.0),
    "push 0.5 N s, 0.3°, 0.5 mm together": draws(0.5, 0.3, 0.5),
}


def speeds_of(scenario: Scenario) -> Vector:
    """Return the rotor speeds at the start and after each step [rad/s], shape (steps + 1, 2)."""
    return ramped(np.random.default_rng(scenario.seed).uniform(-SPEED, SPEED, (KNOTS, 2)))


def plant_states(plant: Plant, scenario: Scenario) -> Vector:
    """Return the states of a plant after each step, shape (steps, 6)."""
    states = []
    for step, there in enumerate(speeds_of(scenario)[1:]):
        if step == PUSH_STEP and scenario.push is not None:
            plant.push(scenario.push.impulse)
        plant.advance(there, STEP)
        states.append(plant.state)
    return np.array(states)


def model_states(scenario: Scenario, disturbance: Disturbance, jump: Vector) -> Vector:
    """Return the states of the model after each step, shape (steps, 9)."""
    states, state = [], without_momentum(scenario.start)
    durations, constants = np.array([STEP]), ROBOT.lumped.as_array()
    for step, ends in enumerate(pairwise(speeds_of(scenario))):
        if step == PUSH_STEP:
            state[MOMENTUM] += jump
        inputs = np.array(ends)
        state = roll_out(state, inputs, durations, constants, disturbance=disturbance)[-1]
        states.append(state)
    return np.array(states)


def compare(scenario: Scenario) -> Vector:
    """Return deviations [m, rad] of both models from the plants, shape (3, 2).

    The model with momentum from `rigid_body` and from `rolling`, the paper's from `rigid_body`.
    """
    settings = DisturbanceSettings(**scenario.disturbances)
    contact = plant_states(RigidBodyPlant(ROBOT, scenario.start, CONTACT, settings), scenario)
    ideal = plant_states(RollingPlant(ROBOT, scenario.start, settings), scenario)
    disturbance = disturbance_of(settings, ROBOT)
    impulse = (0.0, 0.0) if scenario.push is None else scenario.push.impulse
    model = model_states(scenario, disturbance, momentum_of_push(ROBOT, np.array(impulse)))
    paper = model_states(scenario, UNDISTURBED, NO_MOMENTUM)
    pairs: Any = ((model, contact), (model, ideal), (paper, contact))
    return np.array([deviation(found, plant) for found, plant in pairs])


def in_words(found: Vector) -> str:
    """Return median and, in brackets, worst of deviations [m, rad], shape (n, 2)."""
    (metres, angle), (most_metres, most_angle) = np.median(found, axis=0), np.max(found, axis=0)
    return (
        f"{metres:.4f} m, {math.degrees(angle):.2f}° "
        f"({most_metres:.4f} m, {math.degrees(most_angle):.2f}°)"
    )


def main() -> None:
    """Print the table, a row as soon as it is there."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=100)
    arguments = parser.parse_args()
    print(header("disturbance", "with momentum, from `rigid_body`: median (worst)",
                 "with momentum, from `rolling`", "paper's model, from `rigid_body`"))
    scenarios = draw_scenarios(arguments.runs, 0)
    for name, drawn in DISTURBANCES.items():
        found = np.array([compare(drawn.applied_to(scenario)) for scenario in scenarios])
        print(row(name, *(in_words(found[:, pair]) for pair in range(3))), flush=True)


if __name__ == "__main__":
    main()
