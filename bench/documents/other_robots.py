# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Deviation of the plant with contact from ideal rolling, for robots from 3 cm to 1 m.

``python bench/documents/other_robots.py`` prints the table of docs/rigid_body.md.
"""

import argparse
import math

import numpy as np
from plant_runs import deviation, ramped, run
from tables import header, median_and_worst, row

from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import Vector
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

STEPS = 50
"""Steps of the simulator on each ramp."""
RAMPS = 10
"""Ramps of a sequence."""


def scaled(
    radius: float, shell: float, rotor: float, speed: float, acceleration: float,
    axial: float = 0.0, offset: float = 0.0,
) -> RobotParameters:
    """Return a robot with the inertias of Table 1 over mass and squared radius.

    Its radius [m], masses of the shell and of each rotor and counterweight [kg], limits of the
    rotors [rad/s, rad/s^2]; where they are not those of the scale, I1 [kg m^2] and the distance of
    rotors and counterweights from the centre [m].
    """
    axial = axial or 0.008 / (0.7 * 0.3**2) * rotor * radius**2
    return RobotParameters(
        shell_mass=shell, shell_radius=radius, shell_inertia=shell * radius**2 / 1.5,
        rotor_offset=offset or 0.5 * radius, counterweight_mass=rotor, rotor_mass=rotor,
        rotor_axial_inertia=axial, rotor_transverse_inertia=0.5 * axial,
        counterweight_axial_inertia=axial, counterweight_transverse_inertia=0.5 * axial,
        max_rotor_speed=speed, max_rotor_acceleration=acceleration,
    )


ROBOTS = {
    "3.65 cm": scaled(0.0365, 0.05, 0.02, 1000.0, 5000.0),
    "10 cm": scaled(0.1, 0.4, 0.25, 500.0, 1000.0),
    "30 cm, Table 1": RobotParameters(),
    "1 m": scaled(1.0, 30.0, 20.0, 60.0, 50.0, 0.9),
}


def deviations(robot: RobotParameters, number: int) -> Vector:
    """Return the largest distance [radii] and angle [rad] within each of `number` sequences.

    The rotor speeds are uniform in half their range, at which no robot here slips, on the
    shortest ramps allowed.
    """
    found, limit = [], 0.5 * robot.max_rotor_speed
    step = 2.0 * limit / robot.max_rotor_acceleration / STEPS
    for seed in range(number):
        rng = np.random.default_rng([0, seed])
        start = np.concatenate(([0.0, 0.0], random_quaternion(rng)))
        speeds = ramped(rng.uniform(-limit, limit, (RAMPS, 2)), STEPS)
        ideal, contact = RollingPlant(robot, start), RigidBodyPlant(robot, start)
        found.append(deviation(run(contact, speeds, step), run(ideal, speeds, step)))
    return np.array(found).T / [[robot.shell_radius], [1.0]]


def friction_needed(robot: RobotParameters) -> float:
    """Return the friction at which a curve at full speed does not slip, to first order [-]."""
    rate = math.sqrt(2.0) * robot.lumped.input_gain * robot.max_rotor_speed
    return robot.shell_radius * rate**2 / GRAVITY


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sequences", type=int, default=20)
    given = parser.parse_args()
    print(header(
        "radius", "bandwidth [rad/s]", "torque limit [N m]", "time step [ms]",
        "deviation, median (worst) [radii]", "angle [rad]", "friction needed at full speed",
    ))
    for name, robot in ROBOTS.items():
        own = RigidBodySettings().for_robot(robot)
        print(row(
            name, f"{own.drive_bandwidth:.0f}", f"{own.torque_limit:.3g}",
            f"{1e3 * own.time_step:g}",
            *(median_and_worst(found, ".2g") for found in deviations(robot, given.sequences)),
            f"{friction_needed(robot):.2g}",
        ), flush=True)


if __name__ == "__main__":
    main()
