# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the odometry: where it begins, what is known of robot and fixes; its numbers."""

import math
from dataclasses import dataclass, replace

from sphere_nmpc.estimation.settings import TABLE_1_NUMBERS
from sphere_nmpc.model.units import RobotUnits
from sphere_nmpc.quantities import quantity, validate


@dataclass(frozen=True)
class OdometrySettings:
    """Start of the odometry, uncertainty of the robot's parameters, and use of fixes."""

    initial_state: tuple[float, ...] = quantity(
        (0.0, 0.0, 1.0, 0.0, 0.0, 0.0), "m, -",
        "Pose at the start: x, y, then the quaternion w, x, y, z; a tilt that gravity contradicts "
        "is replaced by the measured one",
        minimum=-1e6, maximum=1e6,
    )
    position_deviation: float = quantity(
        1e-3, "m", "Standard deviation of a given position whose covariance is unknown",
        minimum=0.0, maximum=1e3,
    )
    orientation_deviation: float = quantity(
        5e-3, "rad", "Standard deviation of a given orientation whose covariance is unknown",
        minimum=0.0, maximum=3.2,
    )
    calibration_time: float = quantity(
        2.0, "s", "Time at rest in which biases are estimated before the first pose is published",
        minimum=0.0, maximum=600.0,
    )
    radius_deviation: float = quantity(
        3e-3, "-", "Relative standard deviation of the shell's radius", minimum=0.0, maximum=0.3
    )
    constants_deviation: float = quantity(
        1e-2, "-", "Relative standard deviation of the constants of masses and inertias",
        minimum=0.0, maximum=0.3,
    )
    pivoting: float = quantity(
        1e-4, "rad/s",
        "Angular velocity about the vertical at which a sphere that seems to rest may turn; 0 "
        "where the friction of its contact stops it",
        minimum=0.0, maximum=1.0,
    )
    fix_memory: float = quantity(
        1.0, "s", "Age up to which a pose_fix is used", minimum=0.0, maximum=60.0
    )

    def __post_init__(self) -> None:
        validate(self)

    def height_deviation(self, shell_radius: float) -> float:
        """Return the standard deviation of the height of the centre [m]."""
        return self.radius_deviation * shell_radius


@dataclass(frozen=True)
class OdometryNumbers:
    """Numbers of the odometry for the robot of Table 1; `of` returns them for another robot."""

    # Readings
    interval: float = 0.05
    """Time over which readings are taken together [s]."""
    silence: float = 0.2
    """Age of the newest reading at which a sensor counts as silent [s]."""
    remembered: float = 2.0
    """Time for which a fault is reported after it was last seen [s]."""

    # Noises
    least_noises: tuple[float, float] = (3e-5, 1e-3)
    """Least noise densities of gyro [rad/s/sqrt(Hz)] and accelerometer [m/s^2/sqrt(Hz)]."""
    momentum_walk: float = 2.0
    """Random walk of the momentum [rad/s per sqrt(s)]: by friction, slope and imbalance, which are
    not estimated; rolling friction of 2 mm takes 9 rad/s^2 from the robot of Table 1."""
    model_noise: float = 2e-4
    """Noise density of the angular velocity by the balance of momentum [rad/s/sqrt(Hz)]."""
    blind: float = 1.0
    """Random walk of the orientation with neither gyro nor rotor speeds [rad/sqrt(s)]."""
    push: float = TABLE_1_NUMBERS.push
    """Standard deviation of the momentum of a push [rad/s]."""
    offset: float = 0.02
    """Standard deviation of the offset between the stamps of IMU and encoders [s]."""
    vibrates: float = 1.0
    """Time over which the variance of velocities by vibration is averaged [s]."""
    clipped: float = 9.0
    """Most that an interval adds to that variance, over the expected one [-]."""

    # Rest
    rest: float = 1.0
    """Time over which readings may not change for the sphere to be at rest [s]."""
    contradicted: float = 1.5
    """Time at rest after which the readings, if they contradict bias or tilt, are believed [s]."""
    still: float = 2e-4
    """Angular velocity by the rotors below which the sphere may be at rest [rad/s]."""
    bias_jump: float = 0.01
    """Standard deviation of a jump of the gyro's bias, which is seen at rest [rad/s]."""

    # What is not explained
    doubt: float = 3e-4
    """Standard deviation that is added to tilt and bias over gravity where a force is not
    explained [rad]."""
    forgotten: float = 0.7
    """Share of a change of velocity that was not explained which counts in the next interval."""
    settled: float = 0.95
    """Share of a vertical way that was not explained which counts in the next interval."""
    lift: float = 0.03
    """Vertical way above which the sphere has been lifted [m]."""
    lifting: int = 5
    """Intervals in a row that rolling does not explain when the sphere is lifted: 0.25 s, as a
    bump takes less."""
    carried: float = 1.0
    """Random walk of the position of a sphere that has been lifted [m/sqrt(s)]."""

    def improbable(self, components: int) -> float:
        """Return the normalised square that 1 valid measurement in 7000 exceeds (chi-squared)."""
        return _IMPROBABLE_DISTANCES[components - 1]

    def is_lifted(self, height: float, slipping: int) -> bool:
        """Return whether the sphere is lifted, by `height` and `slipping` of a `Belief`."""
        return abs(height) > self.lift and slipping >= self.lifting

    def of(self, units: RobotUnits) -> "OdometryNumbers":
        """Return the numbers in the units of a robot."""
        return replace(
            self, interval=self.interval * units.time, still=self.still / units.time,
            momentum_walk=self.momentum_walk * units.speed / math.sqrt(units.time),
            push=self.push * units.speed, lift=self.lift * units.length,
        )


_IMPROBABLE_DISTANCES = (14.51, 17.76, 20.41, 22.79, TABLE_1_NUMBERS.improbable)
"""Normalised squares of 1 to 5 components that are improbable [-]."""
