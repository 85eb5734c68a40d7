# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What can be learnt about the plant, as five scaled numbers: four constants and the lag."""

import numpy as np

from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector

SIZE = 5
PRIOR = 0.1
"""Standard deviation of each constant over its nominal value, before anything was seen."""
BOUNDS = (0.5, 1.6)
"""Range of each constant over its nominal value."""
LARGEST_RATIO = 0.98
"""The two ratios are below 1 for any mass; the model is singular there."""
LAG_PRIOR = 5e-3
"""Standard deviation of the lag [s] before anything was seen."""
LONGEST_LAG = 0.05
"""Largest lag that can be learnt [s]."""
SHORTEST_LAG = 2e-4
"""A lag below this [s] counts as none: it moves the sphere by less than half a millimetre."""


class Unknowns:
    """Scale, centre, spread and range of [Rs, c1, r1, r3, lag].

    The constants are counted in their nominal values, the lag in `LAG_PRIOR`.

    Parameters
    ----------
    nominal : LumpedConstants
        What the robot was built to.
    lag : float
        Lag that is expected [s].
    """

    def __init__(self, nominal: LumpedConstants, lag: float) -> None:
        self._nominal = nominal.as_array()
        expected = min(lag, LONGEST_LAG) / LAG_PRIOR
        self.centre: Vector = np.append(np.ones(4), expected)
        """Where the prior lies, shape (5,)."""
        self.spread: Vector = np.append(np.full(4, PRIOR), 1.0)
        """Standard deviations of the prior, shape (5,)."""
        self._lowest: Vector = np.append(np.full(4, BOUNDS[0]), 0.0)
        self._highest: Vector = np.append(np.full(4, BOUNDS[1]), LONGEST_LAG / LAG_PRIOR)
        self._highest[2:4] = np.minimum(BOUNDS[1], LARGEST_RATIO / self._nominal[2:4])

    def within(self, scale: Vector) -> Vector:
        """Return the nearest scaled numbers, shape (5,), that a robot can have."""
        kept: Vector = np.minimum(np.maximum(scale, self._lowest), self._highest)
        return kept

    def constants(self, scale: Vector) -> Vector:
        """Return [Rs, c1, r1, r3], shape (4,)."""
        constants: Vector = scale[:4] * self._nominal
        return constants

    def slopes(self) -> Vector:
        """Return how the constants change with their scaled numbers, shape (4,)."""
        return self._nominal.copy()

    def lumped(self, scale: Vector) -> LumpedConstants:
        """Return the constants by name."""
        return LumpedConstants(*(float(value) for value in self.constants(scale)))

    def lag(self, scale: Vector) -> float:
        """Return the lag [s]."""
        return float(scale[4]) * LAG_PRIOR

    def is_highest(self, scale: Vector, index: int) -> bool:
        """Return whether one of the numbers is at the upper end of its range."""
        return bool(scale[index] >= self._highest[index])


def noticeable(lag: float) -> float:
    """Return the lag [s], 0 where it is too short to matter."""
    return lag if lag >= SHORTEST_LAG else 0.0
