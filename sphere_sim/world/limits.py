# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Limits of a controller that go beyond those of the robot."""

import math
from collections.abc import Mapping

from sphere_nmpc.model.parameters import RobotParameters

PLANNED_LIMITS = (
    "max_rotor_speed", "max_rotor_acceleration", "max_rotor_torque", "rotor_axial_inertia"
)
"""Parameters of a controller's robot that determine what its plans demand of the drives."""


def beyond(
    robot: RobotParameters,
    planned: Mapping[str, float],
    controller: str,
    torque_limit: float = math.inf,
) -> str:
    """Return in one line which limits of the robot plans exceed; empty if there are none.

    Parameters
    ----------
    robot : RobotParameters
        The robot itself.
    planned : mapping of str to float
        Values of `PLANNED_LIMITS` in the controller.
    controller : str
        Name of the node that plans.
    torque_limit : float, optional
        Largest torque of a drive [N m].
    """
    speed, acceleration = planned["max_rotor_speed"], planned["max_rotor_acceleration"]
    torque, inertia = planned["max_rotor_torque"], planned["rotor_axial_inertia"]
    if torque > 0.0 and inertia > 0.0:
        acceleration = min(acceleration, torque / inertia)
    attained = torque_limit / robot.rotor_axial_inertia
    figures = (
        ("robot.max_rotor_speed", speed, robot.max_rotor_speed, "rad/s", "as in this node"),
        ("robot.max_rotor_acceleration", acceleration, robot.max_rotor_acceleration, "rad/s^2",
         "as in this node"),
        ("robot.max_rotor_acceleration", acceleration, attained, "rad/s^2",
         f"for rigid_body.torque_limit = {torque_limit:g} N m"),
    )
    return "; ".join(
        f"{name}: given {wanted:g} {unit} in {controller}, expected at most {given:g} {unit}, "
        f"{why}"
        for name, wanted, given, unit, why in figures
        if wanted > given * (1.0 + 1e-9)
    )
