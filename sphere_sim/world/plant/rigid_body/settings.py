# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the plant ``rigid_body``: drives, floor, contact and integration."""

import math
from dataclasses import dataclass, replace

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantities import quantity
from sphere_sim.world.plant.contract import PlantSettings
from sphere_sim.world.plant.rolling_plant import step_scale, time_scale

_BANDWIDTH = 300.0  # [rad/s]
_CONTACT_TIME_CONSTANT, _TIME_STEP = 0.004, 0.002  # [s]
"""Values for the robot of Table 1; docs/rigid_body.md explains them."""
_SHORTEST_STEP = 1e-5  # [s]


@dataclass(frozen=True)
class RigidBodySettings(PlantSettings):
    """Effects that the ideal plant does not have; docs/rigid_body.md explains the defaults.

    Where 0 is the robot's own value, `for_robot` derives it.
    """

    drive_bandwidth: float = quantity(
        0.0, "rad/s",
        "Bandwidth of the rotors' speed servos, cut at 1 / time_step; 0 is the robot's own",
        minimum=0.0, maximum=1e6,
    )
    drive_feedforward: bool = quantity(
        False, "-",
        "Feed the slope of the reference forward, so that the servos follow ramps without lag",
    )
    torque_limit: float = quantity(
        0.0, "N m",
        "Largest torque of a rotor drive; 0 is the robot's own: I1 max_rotor_acceleration",
        minimum=0.0, maximum=1e9,
    )
    friction: float = quantity(
        0.8, "-", "Coefficient of sliding friction between shell and floor", minimum=1e-3,
        maximum=10.0,
    )
    floor_roughness: float = quantity(
        0.0, "m", "Standard deviation of the floor's height; 0 is a plane", minimum=0.0,
        maximum=0.05,
    )
    floor_wavelength: float = quantity(
        0.5, "m", "Spacing of the bumps of a rough floor", minimum=0.05, maximum=10.0
    )
    floor_extent: float = quantity(
        8.0, "m", "Half the side of the rough square, centred at the origin", minimum=0.5,
        maximum=50.0,
    )
    floor_seed: int = quantity(0, "-", "Seed of the rough floor", minimum=0, maximum=2**31 - 1)
    balanced: bool = quantity(
        True, "-",
        "Move the shell's centre of mass so that the common one is the centre of the sphere",
    )
    contact_time_constant: float = quantity(
        0.0,
        "s",
        "Time constant of the contact; shorter is stiffer, at least 2 time_step; 0 is the robot's "
        "own",
        minimum=0.0,
        maximum=1.0,
    )
    contact_impedance: float = quantity(
        0.999, "-", "Impedance of the contact; 1 is rigid", minimum=0.1, maximum=0.9999
    )
    time_step: float = quantity(
        0.0, "s", "Longest integration step; 0 is the robot's own", minimum=0.0, maximum=0.02
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0.0 < self.time_step < _SHORTEST_STEP:
            raise InvalidParameterError(
                "time_step", self.time_step, f"0 or at least {_SHORTEST_STEP:g} s"
            )
        if 0.0 < self.contact_time_constant < 2.0 * self.time_step * (1.0 - 1e-9):
            # MuJoCo would soften the contact without a warning.
            raise InvalidParameterError(
                "contact_time_constant", self.contact_time_constant,
                f"at least twice time_step = {self.time_step:g} s",
            )

    def for_robot(self, robot: RobotParameters) -> "RigidBodySettings":
        """Return the settings with each 0 that stands for the robot's own value replaced by it.

        Drives and steps of integration are as fast as the robot moves, so that in units of its
        radius it deviates from ideal rolling as the robot of Table 1 does; the torque is that of
        the largest acceleration.
        """
        scale = step_scale(robot)
        given = self.contact_time_constant
        step = self.time_step or max(
            _SHORTEST_STEP, min(scale * _TIME_STEP, 0.5 * given if given else math.inf)
        )
        return replace(
            self, drive_bandwidth=self.drive_bandwidth or _BANDWIDTH / time_scale(robot),
            torque_limit=self.torque_limit or robot.full_torque,
            contact_time_constant=given or max(scale * _CONTACT_TIME_CONSTANT, 2.0 * step),
            time_step=step,
        )

    def contradiction(self, robot: RobotParameters) -> str | None:
        """Return in one line how the drives fall short of the robot's limits; None if they do not.

        A `max_rotor_torque` that the drives can give makes up for it: plans then respect it.
        """
        limit, needed = self.for_robot(robot).torque_limit, robot.full_torque
        why = f"for robot.max_rotor_acceleration = {robot.max_rotor_acceleration:g} rad/s^2"
        if 0.0 < robot.max_rotor_torque < needed:
            needed, why = robot.max_rotor_torque, "as robot.max_rotor_torque"
        if limit >= needed * (1.0 - 1e-9):
            return None
        return f"rigid_body.torque_limit: given {limit:g} N m, expected {needed:g} N m {why}"
