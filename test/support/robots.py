# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Robots other than that of Table 1."""

from dataclasses import replace

from sphere_nmpc.model.parameters import RobotParameters

HEAVY_ROTORS = RobotParameters(
    shell_mass=0.4, shell_radius=0.25, shell_inertia=0.02, rotor_offset=0.11,
    counterweight_mass=1.3, rotor_mass=1.3, rotor_axial_inertia=0.011,
    rotor_transverse_inertia=0.006, counterweight_axial_inertia=0.002,
    counterweight_transverse_inertia=0.001,
)
"""Nothing equal by chance as in Table 1; rotors and counterweights must balance each other."""


def scaled_robot(length: float, speed: float) -> RobotParameters:
    """Return a robot with the ratios of Table 1's at other lengths and rotor speeds.

    Parameters
    ----------
    length, speed : float
        Its lengths and its largest rotor speed over those of Table 1's robot [-].
    """
    robot = RobotParameters()
    inertias = {
        name: getattr(robot, name) * length**2
        for name in RobotParameters.__dataclass_fields__ if name.endswith("_inertia")
    }
    return replace(
        robot, **inertias,
        shell_radius=robot.shell_radius * length,
        rotor_offset=robot.rotor_offset * length,
        max_rotor_speed=robot.max_rotor_speed * speed,
        max_rotor_acceleration=robot.max_rotor_acceleration * speed**2,
    )


def _sphere(
    radius: float, shell: float, rotor: float, inertia: float, speed: float, acceleration: float
) -> RobotParameters:
    """Return a robot with a thin shell and rotors halfway between centre and shell."""
    return RobotParameters(
        shell_mass=shell, shell_radius=radius, shell_inertia=2.0 / 3.0 * shell * radius**2,
        rotor_offset=0.5 * radius, rotor_mass=rotor, counterweight_mass=rotor,
        rotor_axial_inertia=inertia, rotor_transverse_inertia=0.5 * inertia,
        counterweight_axial_inertia=inertia, counterweight_transverse_inertia=0.5 * inertia,
        max_rotor_speed=speed, max_rotor_acceleration=acceleration,
    )


PALM = _sphere(0.0365, 0.05, 0.02, 3.4e-6, 1000.0, 5000.0)
"""A sphere that lies in a hand, with fast rotors."""
BALL = _sphere(0.1, 0.4, 0.25, 3.2e-4, 500.0, 1000.0)
"""A sphere of the size of a ball, with slow ramps."""
GIANT = _sphere(1.0, 30.0, 20.0, 0.9, 60.0, 50.0)
"""A sphere of the height of a man."""
SIZES = {"palm": PALM, "ball": BALL, "giant": GIANT}
