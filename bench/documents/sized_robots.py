# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Robots from 3 cm to 1 m, named or drawn at random."""

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters


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


def drawn_robot(seed: int) -> RobotParameters:
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
