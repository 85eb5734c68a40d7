# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""An odometry with all that it has estimated and reported while measurements were passed to it."""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.estimation.odometry.pose_estimate import PoseEstimate
from sphere_nmpc.model.state import Vector
from sphere_nmpc.reporting.conditions import Condition, Kind


@dataclass
class Spell:
    """Time from which and until which a condition was reported [s], in its first words."""

    condition: Condition
    begin: float
    end: float


class FollowedOdometry:
    """Record of the estimates and conditions of an odometry at the times at which it is read."""

    def __init__(self, odometry: Odometry) -> None:
        self.odometry = odometry
        self.estimates: list[PoseEstimate] = []
        """Estimates in their order."""
        self.spells: list[Spell] = []
        """Conditions in the order of their beginnings."""
        self._present: dict[Kind, Spell] = {}

    def read(self, time: float) -> PoseEstimate | None:
        """Record conditions and estimate at a time [s], and return the latter if there is one."""
        odometry = self.odometry
        before, self._present = self._present, {}
        for one in odometry.conditions:
            spell = before.get(one.kind)
            if spell is None:
                spell = Spell(one, time, time)
                self.spells.append(spell)
            spell.end = time
            self._present[one.kind] = spell
        estimate = odometry.estimate
        if estimate is not None:
            self.estimates.append(estimate)
        return estimate


def estimate_table(estimates: list[PoseEstimate]) -> dict[str, Vector]:
    """Return the columns of estimates by name: times, poses and deviations."""
    rows = np.array([(one.time, *one.pose, *one.deviations) for one in estimates])
    names = ("time_s", "x", "y", "qw", "qx", "qy", "qz", "position_deviation_m",
             "heading_deviation_rad", "tilt_deviation_rad")
    return dict(zip(names, rows.T, strict=True))
