# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Units of a robot: the length, time and rotor speed in which all robots move nearly alike.

With lengths in Rs, times in 1 / (c1 u_max) and rotor speeds in u_max, three constants are left:
r1, r3 and the time of a ramp to the largest speed. What suits the robot of Table 1 suits any other
robot in its own units.
"""

import math
from dataclasses import dataclass

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.model.torque import within_torque

_TABLE_1 = RobotParameters()

DEFAULT_MAX_STEP = 0.1
"""Longest integration step of Table 1's robot [s]; error of a 0.5 s interval about 1.5e-4 at the
99th percentile."""
_MAX_RAMP = 4.0
"""Ramp to the largest speed that is planned with, over that of Table 1's robot in units of each.
One of two sample periods of the paper still leads up and down again within the horizon; with ramps
of 27 and 31 `plan_keeping` missed goals and took up to twice as long."""


@dataclass(frozen=True)
class RobotUnits:
    """Units of a robot over those of the robot of Table 1; 1 each for that robot.

    Attributes
    ----------
    length : float
        Ratio of the lengths Rs [-].
    time : float
        Ratio of the times 1 / (c1 U) [-].
    speed : float
        Ratio of the rotor speeds U [-]; U is u_max, or less where a ramp to it takes too long.
    """

    length: float = 1.0
    time: float = 1.0
    speed: float = 1.0

    @classmethod
    def of(cls, robot: RobotParameters) -> "RobotUnits":
        """Return the units of a robot."""
        gain = robot.lumped.input_gain / _TABLE_1.lumped.input_gain
        speed = robot.max_rotor_speed / _TABLE_1.max_rotor_speed
        limits = within_torque(robot)
        acceleration = limits.max_rotor_acceleration / _TABLE_1.max_rotor_acceleration
        ramp = speed / acceleration * gain * speed
        if ramp > _MAX_RAMP:
            speed *= math.sqrt(_MAX_RAMP / ramp)
        return cls(robot.shell_radius / _TABLE_1.shell_radius, 1.0 / (gain * speed), speed)

    @property
    def position_scale(self) -> float:
        """Factor [1/m] on positions in an error that adds them to quaternion components.

        For larger robots it stays 1: plans end where inputs cost more than what is left of the
        error, and that has to be within the tolerance of a user in metres.
        """
        return 1.0 / min(1.0, self.length)

    def scaled(self, state: Vector) -> Vector:
        """Return a state, shape (6,), with its position times `position_scale`."""
        scaled = state.copy()
        scaled[POSITION] *= self.position_scale
        return scaled

    @property
    def max_speed(self) -> float:
        """U [rad/s], the largest rotor speed that is planned with."""
        return self.speed * _TABLE_1.max_rotor_speed


TABLE_1_UNITS = RobotUnits()
"""Units of the robot of Table 1."""
