# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Robots whose parameters are not what the controller believes."""

from dataclasses import fields, replace

import numpy as np

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters

LIMITS = ("max_rotor_speed", "max_rotor_acceleration", "max_rotor_torque")
"""Limits that the drives keep by their own control; they are known, not estimated."""

_DRAWS = 1000
"""Draws before giving up; at 20 % one in about twenty draws is refused."""


def perturbed(
    robot: RobotParameters, fraction: float, rng: np.random.Generator
) -> RobotParameters:
    """Return a robot with each physical parameter times 1 + fraction * U(-1, 1).

    A draw that no robot can have, such as rotors outside the shell, is drawn again as a whole.

    Parameters
    ----------
    robot : RobotParameters
        The nominal parameters.
    fraction : float
        Largest relative change, 0 (the same robot, nothing is drawn) to below 1.
    rng : numpy.random.Generator
        Where the draws come from.

    Raises
    ------
    InvalidParameterError
        If the fraction is not in its range, or leaves no robot that can be.
    """
    if not 0.0 <= fraction < 1.0:
        raise InvalidParameterError("perturbation", fraction, "a fraction from 0 to below 1")
    if fraction == 0.0:
        return robot
    names = [field.name for field in fields(robot) if field.name not in LIMITS]
    for _ in range(_DRAWS):
        factors = 1.0 + fraction * rng.uniform(-1.0, 1.0, size=len(names))
        changes = {
            name: getattr(robot, name) * float(factor)
            for name, factor in zip(names, factors, strict=True)
        }
        try:
            return replace(robot, **changes)
        except InvalidParameterError:
            continue
    raise InvalidParameterError("perturbation", fraction, "one that leaves the robot possible")
