# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random errors of the robot's parameters."""

from dataclasses import fields, replace

import numpy as np

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters

LIMITS = ("max_rotor_speed", "max_rotor_acceleration", "max_rotor_torque")
"""Limits of the drives, which are known exactly: the drives enforce them."""

_ATTEMPTS = 1000
"""Largest number of attempts; at 20 % about one in twenty gives an impossible robot."""


def perturbed(
    robot: RobotParameters, fraction: float, rng: np.random.Generator
) -> RobotParameters:
    """Return a robot with each physical parameter times 1 + fraction * U(-1, 1).

    Parameters that no robot can have, such as rotors outside the shell, are all drawn again.

    Parameters
    ----------
    robot : RobotParameters
        The nominal parameters.
    fraction : float
        Largest relative error, from 0 (the same robot) to below 1.
    rng : numpy.random.Generator
        Generator of the errors.

    Raises
    ------
    InvalidParameterError
        If the fraction is not in its range, or no possible robot is found.
    """
    if not 0.0 <= fraction < 1.0:
        raise InvalidParameterError("perturbation", fraction, "a fraction from 0 to below 1")
    if fraction == 0.0:
        return robot
    names = [field.name for field in fields(robot) if field.name not in LIMITS]
    for _ in range(_ATTEMPTS):
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
