# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Status values of the drift: momentum, slope, centre of mass, and how long the rotors hold."""

import math

from sphere_nmpc.model.drift import Drift, angle_of_slope, offset_of_imbalance, time_to_saturation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector


def drift_values(drift: Drift, robot: RobotParameters, goal: Vector | None) -> dict[str, float]:
    """Return the status values of an estimated drift.

    Parameters
    ----------
    drift : Drift
        The estimate.
    robot : RobotParameters
        Robot as built: the units of the drift, and the limit of the rotor speeds.
    goal : ndarray of shape (6,), or None
        Goal, at which speeds and saturation of the resting rotors are evaluated; without one
        they are nan.
    """
    momentum = robot.rotor_axial_inertia * drift.momentum
    offset = 1e3 * offset_of_imbalance(robot, drift.imbalance)
    speeds, saturation = (math.nan, math.nan), math.nan
    if goal is not None:
        first, second = drift.rest_speeds(goal[QUATERNION]).tolist()
        speeds = first, second
        saturation = time_to_saturation(drift, goal[QUATERNION], robot.max_rotor_speed)
    return {
        **{f"momentum_{axis}": value
           for axis, value in zip("xyz", momentum.tolist(), strict=True)},
        "slope_deg": math.degrees(angle_of_slope(robot, drift.slope)),
        "slope_direction_deg": math.degrees(_downhill(drift.slope)),
        **{f"mass_offset_{axis}_mm": value
           for axis, value in zip("xyz", offset.tolist(), strict=True)},
        "rest_speed_1": speeds[0],
        "rest_speed_2": speeds[1],
        "saturation_s": saturation,
    }


def _downhill(slope: Vector) -> float:
    """Return the downhill direction [rad from the x axis] of a slope's torque; 0 without one."""
    # The torque is perpendicular to it. Subtracted from 0, as -0.0 gives an angle of -0.
    return math.atan2(0.0 - float(slope[0]), float(slope[1]))
