# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Pose at the newest reading, moved on from the end of the last interval."""

import math

import numpy as np

from sphere_nmpc.estimation.odometry.inertial_filter import InertialFilter
from sphere_nmpc.estimation.odometry.inertial_motion import SensorMap
from sphere_nmpc.estimation.odometry.inertial_state import Belief, Samples
from sphere_nmpc.model import rotation
from sphere_nmpc.model.error_state import CONTRADICTING_DEVIATIONS
from sphere_nmpc.model.state import QUATERNION, Vector


class NewestPose:
    """Pose that moves by each reading of the open interval; by the rotors where there is none.

    It begins at a pose, shape (6,), before there is a belief.
    """

    def __init__(self, inertial_filter: InertialFilter, pose: Vector) -> None:
        self._filter = inertial_filter
        self.pose = pose
        """Shape (6,)."""
        self.rate: Vector = np.zeros(3)
        """Angular velocity at the newest reading [rad/s; body frame], shape (3,)."""
        self._sensor: SensorMap | None = None
        self.scatter = math.inf
        """Standard deviation of a rate at rest [rad/s]."""
        self.was_still = False
        """Whether the shell was at rest in the last interval."""

    def follow(self, belief: Belief, samples: Samples, speeds: Vector | None) -> None:
        """Begin with the belief at the start of the interval, and move by its readings.

        `speeds` are the newest ones of the rotors [rad/s], shape (2,); None without any.
        """
        self.pose, self._sensor = belief.pose, self._filter.sensor(belief)
        for last in range(1, len(samples.times)):
            self.move(belief, samples, last, speeds)

    def move(self, belief: Belief, samples: Samples, last: int, speeds: Vector | None) -> None:
        """Move from the reading before the one of this index up to that."""
        two = slice(last - 1, last + 1)
        if all(samples.valid[two]) and self._sensor is not None:
            pair = self._sensor.rates(np.array(samples.rates[two]), np.array(samples.forces[two]))
        elif speeds is None:
            pair = np.zeros((2, 3))
        else:
            turn = rotation.matrix(self.pose[QUATERNION])
            pair = np.array([self._filter.rotors.rate(belief, turn, speeds)[0]] * 2)
        step, self.rate = samples.times[last] - samples.times[last - 1], pair[1]
        limit = CONTRADICTING_DEVIATIONS * self.scatter
        if self.was_still and float(pair[1] @ pair[1]) < limit**2:
            self.rate = np.zeros(3)
            return
        self.pose = self._filter.moved(self.pose, pair, step, self._filter.rolled(belief))
