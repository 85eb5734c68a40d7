# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Unknowns of the estimator, and their distribution after the poses up to a knot.

Common unknowns, shape (9,): the constants [Rs, c1, r1, r3] relative to those of the robot as
built, the lag [s] relative to its prior deviation, the share of the acceleration limit that the
drives attain, and the imbalance [rad/s^2; body frame]. A knot is [state (9), slope (2)], shape
(11,); its error has shape (10,): that of the state (`sphere_nmpc.model.error_state`), and the
slope's. Local unknowns are the errors of a knot and of the common ones, shape (19,).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.error_state import (
    ERROR_SIZE,
    POSE_ERROR,
    apply_error,
    error_between,
    with_block,
)
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import MOMENTUM, POSE, POSE_SIZE, STATE_SIZE, Vector

CONSTANTS, IMBALANCE = slice(0, 4), slice(6, 9)
LAG = CONSTANTS.stop
SHARE, COMMON = LAG + 1, IMBALANCE.stop

KNOT = ERROR_SIZE + 2
MOMENTUM_ERROR = slice(5, 8)
SLOPE_ERROR = slice(8, 10)

LOCAL = KNOT + COMMON
DISTURBANCE = np.r_[5:KNOT, LOCAL - 3 : LOCAL]
"""Places of momentum, slope and imbalance among the local unknowns."""

NORMAL: Vector = np.concatenate((np.ones(4), [0.0, 1.0], np.zeros(3)))
"""Common unknowns of a balanced robot as built, with drives that attain the limit."""

TIGHT = 1e-4
"""Standard deviation of what is zero or fixed, in its unit: no step, but invertible."""

_RANGE = (0.3, 3.0)
"""Range of each constant relative to its nominal value; drives attain at least as small a share of
the acceleration limit."""
_LARGEST_RATIO = 0.98
"""The two ratios are below 1 for any mass; the model is singular there."""
SHARE_STEP = 0.02
"""Least difference from the acceleration limit that counts as weakness of the drives [-]; ramps of
plans are nearer to it."""


class PoseNoise(NamedTuple):
    """Noise of measured poses beyond that given."""

    pose: float = 0.0
    """Standard deviation of the pose [rad; over the radius in m]."""
    time: float = 0.0
    """Standard deviation of the stamp, the time at which it is said to be measured [s]."""


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
    """Units and range of the common unknowns of a robot."""

    nominal: LumpedConstants
    """Constants of the robot as built."""
    acceleration: float
    """Limit of the speeds sent [rad/s^2], which drives may not attain."""
    numbers: EstimatorSettings
    """Prior and noises."""

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
        lowest[SHARE], highest[SHARE] = _RANGE[0], 1.0
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

    def attained(self, common: Vector) -> float:
        """Return the acceleration that the drives attain [rad/s^2]; inf where it is the limit."""
        share = float(common[SHARE])
        return share * self.acceleration if share < 1.0 - SHARE_STEP else np.inf


def disturbance_of(knot: Vector, common: Vector) -> Disturbance:
    """Return slope and imbalance at a knot."""
    return Disturbance(knot[STATE_SIZE:].copy(), common[IMBALANCE].copy())


@dataclass(frozen=True, eq=False)
class Posterior:
    """Distribution of the newest knot and the common unknowns, and what it depends on."""

    time: float
    """Control time of the knot [s]."""
    knot: Vector
    common: Vector
    """Mean of the knot and of the common unknowns, shapes (11,) and (9,)."""
    covariance: Vector
    """Covariance of the local unknowns, (19, 19); what is fixed has its prior variance."""
    undisturbed: bool = True
    """Whether momentum, slope and imbalance are zero."""
    unbalanced: bool = False
    weak: bool = False
    """Whether there is an imbalance, and whether drives attain less than the limit."""
    noise: float = 0.0
    """Standard deviation of the errors of predicted poses, of each state [m, -]."""
    scale: float = 1.0
    """Scale of the noise's variance [-]."""
    slipped: float = np.inf
    """Number of intervals since the sphere has slipped; inf if it never has."""
    pose_noise: PoseNoise = EXACT
    """Noise of the poses beyond that given."""

    @classmethod
    def initial(cls, lag: float, scaling: Scaling) -> "Posterior":
        """Return what is known before the first pose, with an expected lag [s]."""
        knot = np.zeros(POSE_SIZE + 5)
        knot[2] = 1.0
        deviations = np.concatenate((np.ones(5), np.full(5, TIGHT), scaling.deviations))
        return cls(-np.inf, knot, scaling.prior(lag), np.diag(deviations**2))

    @property
    def is_valid(self) -> bool:
        """Whether a fit can begin from it: a finite mean, a positive definite covariance."""
        given = (self.knot, self.common, self.covariance)
        if not all(np.isfinite(one).all() for one in given):
            return False
        try:
            np.linalg.cholesky(np.linalg.inv(self.covariance))
        except np.linalg.LinAlgError:
            return False
        return bool((np.diag(self.covariance) > 0.0).all())

    def with_lag(self, lag: float, scaling: Scaling) -> "Posterior":
        """Return the posterior with the prior of another lag [s] in place of its estimate."""
        common, variance = self.common.copy(), scaling.deviations[LAG] ** 2
        common[LAG] = scaling.prior(lag)[LAG]
        at = slice(KNOT + LAG, KNOT + LAG + 1)
        return replace(self, common=common, covariance=with_block(self.covariance, at, variance))

    def without_disturbance(self, numbers: EstimatorSettings) -> "Posterior":
        """Return the posterior with zero momentum, slope and imbalance."""
        knot, common = self.knot.copy(), self.common.copy()
        knot[MOMENTUM.start :] = 0.0
        common[IMBALANCE] = 0.0
        variances = np.repeat([TIGHT**2, numbers.imbalance**2], [5, 3])
        covariance = with_block(self.covariance, DISTURBANCE, np.diag(variances))
        return replace(
            self, knot=knot, common=common, covariance=covariance, undisturbed=True,
            unbalanced=False,
        )

    def with_unknown_momentum(self, numbers: EstimatorSettings) -> "Posterior":
        """Return the posterior with more variance of momentum and slope, whatever they are."""
        covariance = self.covariance.copy()
        covariance[MOMENTUM_ERROR, MOMENTUM_ERROR] += np.eye(3) * numbers.push**2
        covariance[SLOPE_ERROR, SLOPE_ERROR] += np.eye(2) * numbers.tilt**2
        return replace(self, covariance=covariance, undisturbed=False)

    def at_pose(self, time: float, pose: Vector, variance: Vector) -> "Posterior":
        """Return the posterior at a pose, (6,), measured with a variance, (5,), after a gap.

        What happened to the momentum in between is not known, if there is any.
        """
        knot = self.knot.copy()
        knot[POSE] = pose
        covariance = with_block(self.covariance, POSE_ERROR, np.diag(variance))
        return replace(self, time=time, knot=knot, covariance=covariance)

    def is_zero(self, numbers: EstimatorSettings) -> bool:
        """Return whether momentum, slope and imbalance may well be zero.

        They are within a few standard deviations of it, and known so well that zero is more
        probable than other values (the Savage-Dickey ratio).
        """
        places = DISTURBANCE if self.unbalanced else DISTURBANCE[:5]
        values = np.concatenate((self.knot[MOMENTUM.start :], self.common[IMBALANCE]))
        values, within = values[: places.size], self.covariance[np.ix_(places, places)]
        square = float(values @ np.linalg.solve(within, values))
        wide = np.repeat([numbers.push, numbers.tilt, numbers.imbalance], [3, 2, 3])[: places.size]
        narrowed = float(np.linalg.slogdet(within)[1]) - 2.0 * float(np.sum(np.log(wide)))
        return square < numbers.improbable and square + narrowed < -numbers.improbable
