# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What gives the sphere angular momentum in any plant: pushes, slope, centre of mass, friction."""

import math
from dataclasses import dataclass

from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.quantities import quantity, validate


@dataclass(frozen=True)
class Push:
    """Push at the centre of the sphere."""

    time: float  #: Time from the start of the run [s].
    impulse: tuple[float, float]  #: Impulse x, y [N s; world frame].


@dataclass(frozen=True)
class DisturbanceSettings:
    """Slope of the floor, offset of the centre of mass, and friction against rolling."""

    slope: float = quantity(
        0.0, "rad", "Inclination of the floor; x and y are measured in the floor", minimum=0.0,
        maximum=0.5, live=True,
    )
    slope_direction: float = quantity(
        0.0, "rad", "Downhill direction: angle from the x axis", minimum=-math.pi, maximum=math.pi,
        live=True,
    )
    mass_offset_x: float = quantity(
        0.0, "m", "Common centre of mass, along the body's x axis", minimum=-0.03, maximum=0.03
    )
    mass_offset_y: float = quantity(
        0.0, "m", "Common centre of mass, along the body's y axis", minimum=-0.03, maximum=0.03
    )
    mass_offset_z: float = quantity(
        0.0, "m", "Common centre of mass, along the body's z axis", minimum=-0.03, maximum=0.03
    )
    rolling_friction: float = quantity(
        0.0, "m", "Friction torque against rolling over normal force", minimum=0.0, maximum=1.0
    )
    torsional_friction: float = quantity(
        0.0, "m", "Friction torque against spinning on the spot over normal force", minimum=0.0,
        maximum=1.0,
    )

    def __post_init__(self) -> None:
        validate(self)

    @property
    def mass_offset(self) -> tuple[float, float, float]:
        """Common centre of mass [m; body frame]."""
        return self.mass_offset_x, self.mass_offset_y, self.mass_offset_z

    @property
    def gravity(self) -> tuple[float, float, float]:
        """Acceleration of free fall [m/s^2; world frame, which is that of the floor]."""
        along = GRAVITY * math.sin(self.slope)
        return (
            along * math.cos(self.slope_direction), along * math.sin(self.slope_direction),
            -GRAVITY * math.cos(self.slope),
        )
