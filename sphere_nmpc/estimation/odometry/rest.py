# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Detector of rest, by the rotors and the gyro."""

import math
from collections import deque

import numpy as np

from sphere_nmpc.estimation.odometry.inertial_filter import InertialFilter
from sphere_nmpc.estimation.odometry.inertial_state import GYRO_BIAS, Belief, Samples
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers
from sphere_nmpc.model.state import Vector

_SIGNIFICANT = 4.0
"""Standard deviations [-] that the mean rate at rest may differ from the bias of the gyro."""
MOST_NOISE = 6.0
"""Standard deviations of its noise [-] by which a reading of the gyro may differ at rest."""


class RestDetector:
    """Test of whether rotors and shell are at rest.

    With the rotors at rest the shell may still turn slowly, by a momentum. That shows in the mean
    rate over a while, and once it has, a whole such while without it is needed.

    Parameters
    ----------
    inertial_filter : InertialFilter
        Model of the gyro.
    gain : float
        Angular velocity of the shell over the speed of a rotor, c1 [-].
    numbers : OdometryNumbers
        How long the while is, and how slow the rotors have to be.
    """

    def __init__(
        self, inertial_filter: InertialFilter, gain: float, numbers: OdometryNumbers
    ) -> None:
        self._filter, self._numbers = inertial_filter, numbers
        self._slowest = numbers.still / gain
        self._turned: deque[tuple[float, Vector]] = deque()
        self._turns = False

    def is_at_rest(self, belief: Belief, samples: Samples) -> bool:
        """Return whether the sphere was at rest in an interval, the next one."""
        speeds = samples.speeds
        if speeds is None or not samples.usable or np.max(np.abs(speeds)) > self._slowest:
            self._turned.clear()
            self._turns = False
            return False
        rates, duration = np.array(samples.rates), samples.duration
        self._turned.append((duration, duration * 0.5 * (rates[:-1] + rates[1:]).mean(axis=0)))
        while sum(one for one, _ in self._turned) > self._numbers.rest * (1.0 + 1e-6):
            self._turned.popleft()
        whole = sum(one for one, _ in self._turned)
        mean = np.sum([turned for _, turned in self._turned], axis=0) / whole
        rate = self._filter.body_rates(belief, mean[None])[0]
        noise = self._filter.imu.gyro_noise
        begins = bool(np.max(np.abs(rates - mean)) > MOST_NOISE * noise / math.sqrt(samples.step))
        spread = float(np.trace(belief.covariance[GYRO_BIAS, GYRO_BIAS]))
        spread += 3.0 * noise**2 / whole
        if begins or float(rate @ rate) > _SIGNIFICANT**2 * spread:
            self._turns = True
            self._turned.clear()
        elif whole > self._numbers.rest - duration:
            self._turns = False
        return not self._turns
