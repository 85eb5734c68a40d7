# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of the estimator: the prior, the noises, and how likely pushes, tilts and slip are."""

import math
from dataclasses import dataclass, replace

from sphere_nmpc.model.units import RobotUnits


@dataclass(frozen=True)
class EstimatorSettings:
    """Numbers of the estimator for the robot of Table 1; `of` returns them for another robot."""

    # Poses and intervals
    spacing: float = 0.2
    """Least time between two knots, which are poses [s]; half of it for exact ones as long as the
    constants are not known."""
    known: float = 5e-3
    """Relative standard deviation below which a constant is known [-]."""
    longest: float = 2.0
    """Longest interval [s]; predictions over longer ones are inaccurate."""
    pose_spacing: float = 0.01
    """Least time between noisy poses within an interval that are used [s]."""
    lead: float = 1.0
    """Time before an interval from which speeds sent are kept [s]: weak drives may have fallen
    behind since."""
    window: int = 8
    """Intervals that are fitted together."""
    step: float = 0.05
    """Longest integration step of the prediction [s]."""

    # Prior
    constants: tuple[float, float, float, float] = (0.12, 0.22, 0.07, 0.08)
    """Standard deviations of [Rs, c1, r1, r3], relative to those of the robot as built [-]: those
    of robots whose masses, sizes and inertias differ by up to 20 %."""
    lag: float = 5e-3
    """Standard deviation of the lag [s]."""
    longest_lag: float = 0.05
    """Largest lag that is estimated [s]."""
    share: float = 0.15
    """Standard deviation of the share of the acceleration limit that the drives attain, around
    1 [-]."""
    imbalance: float = 10.0
    """Standard deviation of the imbalance, where there is any [rad/s^2]."""

    # Noises
    pose: float = 1e-5
    """Least standard deviation of a pose [m, rad]."""
    prediction: float = 3e-4
    """Standard deviation of a pose predicted over an interval at rest [m, rad], and of what is
    added to it for each rad that is rolled."""
    share_spread: float = 0.03
    """Standard deviation of the share between intervals [-]: what a drive attains of its limit
    also depends on its controller."""
    momentum_walk: float = 0.05
    """Random walk of a momentum that is not zero [rad/s per sqrt(s)]."""
    slope_walk: float = 0.1
    """Random walk of the slope below a momentum that is not zero [rad/s^2 per sqrt(s)]."""

    # Events
    push: float = 50.0
    """Standard deviation of the momentum of a push [rad/s]."""
    tilt: float = 15.0
    """Standard deviation of a step of the slope [rad/s^2]."""
    late: float = 0.1
    """Standard deviation of the delay of a command that is late or lost [s]."""
    slip: float = 0.2
    """Standard deviation of slip within an interval [rad], and of its path over the radius."""
    rare: float = 14.0
    """What an event or an imbalance costs: -2 log of its probability in an interval."""
    again: float = 4.0
    """What slip costs on a floor on which the sphere has slipped."""
    improbable: float = 25.0
    """Normalised square of a pose or a step above which something else has happened: exceeded by
    1 valid pose in 7000 (chi-squared, 5 degrees of freedom)."""
    slippery: int = 40
    """Intervals after slip in which the floor counts as slippery."""

    # Poses that are wrong
    most_outliers: int = 4
    """Poses, or fixes of the odometry, in a row that are left out as improbable; the next one is
    believed."""

    @property
    def recent(self) -> int:
        """Number of newest intervals in which events are looked for: half of the window."""
        return self.window // 2

    def of(self, units: RobotUnits) -> "EstimatorSettings":
        """Return the numbers in the units of a robot."""
        torque, root = units.speed / units.time, math.sqrt(units.time)
        return replace(
            self,
            spacing=self.spacing * units.time,
            longest=self.longest * units.time,
            lead=self.lead * units.time,
            step=self.step * units.time,
            imbalance=self.imbalance * torque,
            momentum_walk=self.momentum_walk * units.speed / root,
            slope_walk=self.slope_walk * torque / root,
            push=self.push * units.speed,
            tilt=self.tilt * torque,
            late=self.late * units.time,
        )


TABLE_1_NUMBERS = EstimatorSettings()
"""Numbers of the estimator for the robot of Table 1."""
