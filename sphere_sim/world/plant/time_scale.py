# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time scale of a robot's motion, with which the plants' constants of time are chosen."""

import math

from sphere_nmpc.model.parameters import RobotParameters

_REFERENCE = RobotParameters()
"""Robot of Table 1, for which the constants were measured."""


def time_scale(robot: RobotParameters) -> float:
    """Return the robot's unit of time, 1 / (c1 u_max), over that of Table 1 [-]."""
    return _fastest_rate(_REFERENCE) / _fastest_rate(robot)


def step_scale(robot: RobotParameters) -> float:
    """Return the factor on steps of integration [-]: the time scale as a power of two, at most 1.

    Rounded, so that errors of the parameters change neither the steps nor, thereby, the rounding
    of results. Slow robots have the steps of Table 1, as gravity acts on all at the same pace.
    """
    return min(1.0, 2.0 ** round(math.log2(time_scale(robot))))


def _fastest_rate(robot: RobotParameters) -> float:
    """Return c1 u_max [rad/s]."""
    return robot.lumped.input_gain * robot.max_rotor_speed
