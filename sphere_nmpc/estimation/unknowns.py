# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Unknowns of the estimator: what is common to all poses, and the knots at some of them.

Common unknowns, shape (9,): the constants [Rs, c1, r1, r3] relative to those of the robot as
built, the lag [s] relative to its prior deviation, the share of the acceleration limit that the
drives attain, and the imbalance [rad/s^2; body frame]. A knot is [state (9), slope (2)], shape
(11,); its error has shape (10,): that of the state (`sphere_nmpc.model.error_state`), and the
slope's. Local unknowns are the errors of a knot and of the common ones, shape (19,).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.error_state import ERROR_SIZE, apply_error, error_between
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import STATE_SIZE, Vector

COMMON = 9
LAG, SHARE = 4, 5
CONSTANTS, IMBALANCE = slice(0, 4), slice(6, 9)

KNOT = ERROR_SIZE + 2
POSE_ERROR = slice(0, 5)
MOMENTUM_ERROR = slice(5, 8)
SLOPE_ERROR = slice(8, 10)

LOCAL = KNOT + COMMON
DISTURBANCE = np.r_[5:KNOT, LOCAL - 3 : LOCAL]
"""Places of momentum, slope and imbalance among the local unknowns."""

NORMAL: Vector = np.concatenate((np.ones(4), [0.0, 1.0], np.zeros(3)))
"""Common unknowns of a balanced robot as built, with drives that attain the limit."""

_RANGE = (0.3, 3.0)
"""Range of each constant relative to its nominal value."""
_LARGEST_RATIO = 0.98
"""The two ratios are below 1 for any mass; the model is singular there."""
_LEAST_SHARE = 0.4
"""Least share of the acceleration limit that drives attain."""
_SHORTEST_LAG = 2e-4
"""A lag below this [s] is taken as zero: it moves the sphere by less than half a millimetre."""
_ATTAINED = 0.98
"""Share above which the drives count as attaining the limit."""


class PoseNoise(NamedTuple):
    """Noise of measured poses beyond that given.

    Attributes
    ----------
    pose : float
        Standard deviation of the pose [rad; over the radius in m].
    time : float
        Standard deviation of the stamp, the time at which it is said to be measured [s].
    """

    pose: float = 0.0
    time: float = 0.0


EXACT = PoseNoise()


def apply_knot_error(knot: Vector, error: Vector) -> Vector:
    """Return a knot, shape (11,), changed by an error, shape (10,)."""
    state = apply_error(knot[:STATE_SIZE], error[:ERROR_SIZE])
    return np.concatenate((state, knot[STATE_SIZE:] + error[ERROR_SIZE:]))


def knot_error(knot: Vector, other: Vector) -> Vector:
    """Return the error, shape (10,), that leads from one knot to another."""
    error = error_between(knot[:STATE_SIZE], other[:STATE_SIZE])
    return np.concatenate((error, other[STATE_SIZE:] - knot[STATE_SIZE:]))


@dataclass(frozen=True, eq=False)
class Scaling:
    """Units and range of the common unknowns of a robot.

    Attributes
    ----------
    nominal : LumpedConstants
        Constants of the robot as built.
    acceleration : float
        Limit of the speeds sent [rad/s^2], which drives may not attain.
    numbers : EstimatorSettings
        Prior and noises.
    """

    nominal: LumpedConstants
    acceleration: float
    numbers: EstimatorSettings

    def prior(self, lag: float) -> Vector:
        """Return the prior mean, shape (9,), with an expected lag [s]."""
        mean = NORMAL.copy()
        mean[LAG] = min(lag, self.numbers.longest_lag) / self.numbers.lag
        return mean

    @property
    def deviations(self) -> Vector:
        """Prior standard deviations, shape (9,), of a robot out of balance."""
        numbers = self.numbers
        return np.array([*numbers.constants, 1.0, numbers.share] + [numbers.imbalance] * 3)

    @cached_property
    def units(self) -> Vector:
        """Scale of changes of the local unknowns, shape (19,)."""
        numbers = self.numbers
        knot = np.repeat([1.0, numbers.push, numbers.tilt], [5, 3, 2])
        return np.concatenate((knot, self.deviations))

    def pose_variance(self, noise: float, given: Vector | float = 0.0) -> Vector:
        """Return the variance, shape (5,), of poses with this noise [rad; over Rs in m].

        It comes beside the deviations `given` [m, rad].
        """
        radius = float(self.nominal.as_array()[0])
        variance: Vector = np.array([noise * radius] * 2 + [noise] * 3) ** 2 + np.square(given)
        return variance

    def pose_covariance(self, noise: PoseNoise, given: Vector, rates: Vector) -> Vector:
        """Return the covariances, shape (..., 5, 5), of poses that change at rates, (..., 5).

        A wrong stamp moves a pose along its own velocity. The noise comes beside the deviations
        `given`, shape (5,) [m, rad]; rates are in m/s and rad/s.
        """
        along = noise.time * rates
        found: Vector = along[..., :, None] * along[..., None, :]
        found += np.diag(self.pose_variance(noise.pose, given))
        return found

    def within(self, common: Vector) -> Vector:
        """Return the nearest common unknowns, shape (9,), within their range."""
        nominal = self.nominal.as_array()
        lowest, highest = np.full(COMMON, -np.inf), np.full(COMMON, np.inf)
        lowest[CONSTANTS], highest[CONSTANTS] = _RANGE
        highest[2:4] = np.minimum(_RANGE[1], _LARGEST_RATIO / nominal[2:4])
        # Negative where stamps are earlier than the measurements.
        highest[LAG] = self.numbers.longest_lag / self.numbers.lag
        lowest[LAG] = -highest[LAG]
        lowest[SHARE], highest[SHARE] = _LEAST_SHARE, 1.0
        kept: Vector = np.minimum(np.maximum(common, lowest), highest)
        return kept

    def constants(self, common: Vector) -> Vector:
        """Return [Rs, c1, r1, r3], shape (4,)."""
        constants: Vector = common[CONSTANTS] * self.nominal.as_array()
        return constants

    def lumped(self, common: Vector) -> LumpedConstants:
        """Return the constants by name."""
        return LumpedConstants(*self.constants(common).tolist())

    def lag(self, common: Vector) -> float:
        """Return the lag [s]."""
        return float(common[LAG]) * self.numbers.lag

    def significant_lag(self, common: Vector) -> float:
        """Return the lag [s], or 0 where it is too short to matter."""
        lag = self.lag(common)
        return lag if abs(lag) >= _SHORTEST_LAG else 0.0

    def attained(self, common: Vector) -> float:
        """Return the acceleration that the drives attain [rad/s^2]; inf where it is the limit."""
        share = float(common[SHARE])
        return share * self.acceleration if share < _ATTAINED else np.inf


def disturbance_of(knot: Vector, common: Vector) -> Disturbance:
    """Return slope and imbalance at a knot."""
    return Disturbance(knot[STATE_SIZE:].copy(), common[IMBALANCE].copy())
