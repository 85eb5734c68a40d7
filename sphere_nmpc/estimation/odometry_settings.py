# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the odometry: where it begins, what is known of robot and fixes; its numbers."""

from dataclasses import dataclass, replace

from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.model.state import DEFAULT_START
from sphere_nmpc.model.units import RobotUnits
from sphere_nmpc.quantity import quantity, validate


@dataclass(frozen=True)
class OdometrySettings:
    """Start of the odometry, uncertainty of the robot's parameters, and use of fixes."""

    initial_state: tuple[float, ...] = quantity(
        DEFAULT_START, "m, -",
        "Pose at the start: x, y, then the quaternion w, x, y, z, by default that of the "
        "simulator; a tilt that gravity contradicts is replaced by the measured one",
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


@dataclass(frozen=True)
class OdometryNumbers(EstimatorSettings):
    """Numbers of the odometry beside those of the estimator; `of` returns them for a robot."""

    interval: float = 0.05
    """Time over which readings are taken together [s]."""
    momentum_walk: float = 2.0
    """Random walk of the momentum [rad/s per sqrt(s)]: by friction, slope and imbalance, which are
    not estimated; rolling friction of 2 mm takes 9 rad/s^2 from the robot of Table 1."""
    least_noises: tuple[float, float] = (3e-5, 1e-3)
    """Least noise densities of gyro [rad/s/sqrt(Hz)] and accelerometer [m/s^2/sqrt(Hz)]."""
    model_noise: float = 2e-4
    """Noise density of the angular velocity by the balance of momentum [rad/s/sqrt(Hz)]."""
    blind: float = 1.0
    """Random walk of the orientation with neither gyro nor rotor speeds [rad/sqrt(s)]."""
    offset: float = 0.02
    """Standard deviation of the offset between the stamps of IMU and encoders [s]."""
    still: float = 2e-4
    """Angular velocity by the rotors below which the sphere may be at rest [rad/s]."""
    rest: float = 1.0
    """Time over which the gyro is averaged to tell rest from slow turning [s]."""
    doubt: float = 3e-4
    """Standard deviation that is added to tilt and bias over gravity where a force is not
    explained [rad]."""
    forgotten: float = 0.7
    """Share of a change of velocity that was not explained which counts in the next interval."""
    lift: float = 0.1
    """Vertical velocity above which the sphere has been lifted [m/s]."""
    carried: float = 1.0
    """Random walk of the position of a sphere that has been lifted [m/sqrt(s)]."""
    silence: float = 0.2
    """Age of the newest reading at which a sensor counts as silent [s]."""
    remembered: float = 2.0
    """Time for which a fault is told after it was last seen [s]."""

    def of(self, units: RobotUnits) -> "OdometryNumbers":
        """Return the numbers in the units of a robot."""
        return replace(
            super().of(units), interval=self.interval * units.time,
            still=self.still / units.time, lift=self.lift * units.length / units.time,
        )
