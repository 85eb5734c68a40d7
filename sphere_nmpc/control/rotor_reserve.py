# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Warnings that the rotors will soon be, or are, too slow to hold the momentum at the goal."""

import math

import numpy as np

from sphere_nmpc.model.drift import Drift, push_against, time_to_saturation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector

_NEAR = 0.7
"""Share of the limit of the rotor speeds from which on it is near [-]."""
_SOON = 60.0
"""Longest time to the limit that is told [s]; slower changes are within the estimate's error."""


def rotor_reserve(drift: Drift, robot: RobotParameters, goal: Vector) -> dict[str, str]:
    """Return the warning about the rotors that hold a momentum at rest, by its kind; or none.

    Parameters
    ----------
    drift : Drift
        Estimated momentum, slope and imbalance.
    robot : RobotParameters
        Limit of the rotor speeds, and the robot's inertia.
    goal : ndarray, shape (6,)
        Goal at which the sphere is to rest.
    """
    quaternion, limit = goal[QUATERNION], robot.max_rotor_speed
    needed = float(np.max(np.abs(drift.rest_speeds(quaternion))))
    if needed < _NEAR * limit:
        return {}
    x, y = push_against(robot, drift.momentum).tolist()
    push = f"a push of {math.hypot(x, y):.2g} N s towards {math.degrees(math.atan2(y, x)):.0f} deg"
    if needed >= limit:
        return {
            "rotors at their limit": f"given a momentum that needs {needed:.0f} rad/s at the "
            f"goal, expected at most {limit:.0f}; the sphere rolls until {push} or the opposite "
            "slope takes the momentum, which a level floor leaves as it is"
        }
    left = time_to_saturation(drift, quaternion, limit)
    if left > _SOON:
        return {}
    return {
        "rotors near their limit": f"given {needed:.0f} of {limit:.0f} rad/s to hold the momentum "
        f"at the goal, and {left:.1f} s until it can be held no longer; a level floor, a balanced "
        f"sphere or {push} helps"
    }
