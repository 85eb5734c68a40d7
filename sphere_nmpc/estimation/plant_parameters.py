# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimated parameters of the plant as scaled numbers: four lumped constants and the lag."""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector

SIZE = 5
LAG = 4
"""Index of the lag."""
PRIOR = 0.1
"""Prior standard deviation of each constant, relative to its nominal value."""
BOUNDS = (0.5, 1.6)
"""Range of each constant relative to its nominal value."""
LARGEST_RATIO = 0.98
"""The two ratios are below 1 for any mass; the model is singular there."""
LAG_PRIOR = 5e-3
"""Prior standard deviation of the lag [s]."""
LONGEST_LAG = 0.05
"""Largest lag that can be estimated [s]."""
SHORTEST_LAG = 2e-4
"""A lag below this [s] is taken as zero: it moves the sphere by less than half a millimetre."""
PRIOR_DEVIATION: Vector = np.append(np.full(4, PRIOR), 1.0)
"""Prior standard deviations of the scaled parameters, shape (5,)."""


@dataclass(frozen=True, eq=False)
class ParameterDistribution:
    """Gaussian distribution of the scaled parameters: mean (5,) and covariance (5, 5)."""

    mean: Vector
    covariance: Vector

    @classmethod
    def prior(cls, lag: float) -> "ParameterDistribution":
        """Return the prior around the nominal constants and the expected lag [s]."""
        return cls(_nominal(lag), np.diag(PRIOR_DEVIATION**2))

    @classmethod
    def known(cls, lag: float) -> "ParameterDistribution":
        """Return the nominal constants and a lag [s] that are taken as exact."""
        return cls(_nominal(lag), np.zeros((SIZE, SIZE)))

    def with_lag_prior(self, lag: float) -> "ParameterDistribution":
        """Return the distribution with the prior of another lag [s] in place of its estimate."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[LAG] = _nominal(lag)[LAG]
        covariance[LAG, :] = covariance[:, LAG] = 0.0
        covariance[LAG, LAG] = PRIOR_DEVIATION[LAG] ** 2
        return ParameterDistribution(mean, covariance)


class ParameterScaling:
    """Units and range of the scaled parameters [Rs, c1, r1, r3, lag].

    The unit of a constant is its nominal value, that of the lag is `LAG_PRIOR`.
    """

    def __init__(self, nominal: LumpedConstants) -> None:
        self._nominal = nominal.as_array()
        self._lowest: Vector = np.append(np.full(4, BOUNDS[0]), 0.0)
        self._highest: Vector = np.append(np.full(4, BOUNDS[1]), LONGEST_LAG / LAG_PRIOR)
        self._highest[2:4] = np.minimum(BOUNDS[1], LARGEST_RATIO / self._nominal[2:4])

    def within(self, scaled: Vector) -> Vector:
        """Return the nearest scaled parameters, shape (5,), within the range."""
        kept: Vector = np.minimum(np.maximum(scaled, self._lowest), self._highest)
        return kept

    def constants(self, scaled: Vector) -> Vector:
        """Return [Rs, c1, r1, r3], shape (4,)."""
        constants: Vector = scaled[:4] * self._nominal
        return constants

    def slopes(self) -> Vector:
        """Return the derivatives of the constants by their scaled values, shape (4,)."""
        return self._nominal.copy()

    def lumped(self, scaled: Vector) -> LumpedConstants:
        """Return the constants by name."""
        return LumpedConstants(*(float(value) for value in self.constants(scaled)))

    def lag(self, scaled: Vector) -> float:
        """Return the lag [s]."""
        return float(scaled[LAG]) * LAG_PRIOR

    def is_highest(self, scaled: Vector, index: int) -> bool:
        """Return whether a parameter is at the upper end of its range."""
        return bool(scaled[index] >= self._highest[index])


def significant(lag: float) -> float:
    """Return the lag [s], or 0 where it is shorter than `SHORTEST_LAG`."""
    return lag if lag >= SHORTEST_LAG else 0.0


def _nominal(lag: float) -> Vector:
    mean: Vector = np.append(np.ones(4), min(lag, LONGEST_LAG) / LAG_PRIOR)
    return mean
