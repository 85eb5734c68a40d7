# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Robots other than that of Table 1."""

from sized_robots import ROBOTS

from sphere_nmpc.model.parameters import RobotParameters

HEAVY_ROTORS = RobotParameters(
    shell_mass=0.4, shell_radius=0.25, shell_inertia=0.02, rotor_offset=0.11,
    counterweight_mass=1.3, rotor_mass=1.3, rotor_axial_inertia=0.011,
    rotor_transverse_inertia=0.006, counterweight_axial_inertia=0.002,
    counterweight_transverse_inertia=0.001,
)
"""Nothing equal by chance as in Table 1; rotors and counterweights must balance each other."""
PALM, BALL, GIANT = (ROBOTS[radius] for radius in ("3.65 cm", "10 cm", "1 m"))
SIZES = {"palm": PALM, "ball": BALL, "giant": GIANT}
