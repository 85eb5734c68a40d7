# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Momentum with slope and imbalance in one object."""

from dataclasses import dataclass, field, replace

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.rotation import Vector

MOMENTUM = slice(0, 3)
SLOPE = slice(3, 5)
IMBALANCE = slice(5, 8)
DRIFT_SIZE = 8
"""Layout of a drift as an array."""


def _zeros(size: int) -> Vector:
    zeros: Vector = np.zeros(size)
    zeros.flags.writeable = False
    return zeros


@dataclass(frozen=True, eq=False)
class Drift:
    """Momentum at an instant, and the torques that change it.

    Attributes
    ----------
    momentum : ndarray, shape (3,)
        h [rad/s; world frame].
    slope : ndarray, shape (2,)
        s, the torque of a slope over I1 [rad/s^2; world frame].
    imbalance : ndarray, shape (3,)
        a = Mt g c / I1 of a centre of mass at c [rad/s^2; body frame].
    """

    momentum: Vector = field(default_factory=lambda: _zeros(3))
    slope: Vector = field(default_factory=lambda: _zeros(2))
    imbalance: Vector = field(default_factory=lambda: _zeros(3))

    @classmethod
    def from_array(cls, values: Vector) -> "Drift":
        """Return the drift of an array laid out [h, s, a], shape (8,)."""
        return cls(values[MOMENTUM].copy(), values[SLOPE].copy(), values[IMBALANCE].copy())

    def as_array(self) -> Vector:
        """Return [h, s, a], shape (8,)."""
        return np.concatenate((self.momentum, self.slope, self.imbalance))

    @property
    def is_zero(self) -> bool:
        """Whether the model is the paper's: no momentum, level and balanced."""
        # The identity first: this is asked several times a solve.
        if self is NO_DRIFT:
            return True
        return not (self.momentum.any() or self.slope.any() or self.imbalance.any())

    def torque_at_rest(self, quaternion: Vector) -> Vector:
        """Return dh/dt of a sphere that rests at an orientation (4,) [rad/s^2; world], (3,)."""
        world = rotation.matrix(quaternion) @ self.imbalance
        return np.array([self.slope[0] - world[1], self.slope[1] + world[0], 0.0])

    def in_body(self, quaternion: Vector) -> Vector:
        """Return the momentum in the body frame at an orientation (4,) [rad/s], shape (3,)."""
        if self is NO_DRIFT:
            return np.zeros(3)
        turned: Vector = rotation.matrix(quaternion).T @ self.momentum
        return turned

    def rest_speeds(self, quaternion: Vector) -> Vector:
        """Return the rotor speeds that hold the momentum at an orientation [rad/s], shape (2,).

        With them the sphere rests if the component of the momentum along the body's z axis is
        zero; otherwise it turns slowly about that axis.
        """
        return self.in_body(quaternion)[:2]

    def after_slope(self, duration: float) -> "Drift":
        """Return the drift after `duration` [s] of the slope's torque alone."""
        if self is NO_DRIFT:
            return self
        gained = duration * np.append(self.slope, 0.0)
        return replace(self, momentum=self.momentum + gained)

    def after_rest(self, quaternion: Vector, duration: float) -> "Drift":
        """Return the drift after a rest of `duration` [s] at an orientation, shape (4,)."""
        gained = duration * self.torque_at_rest(quaternion)
        return replace(self, momentum=self.momentum + gained)

    @classmethod
    def of(cls, momentum: Vector, disturbance: Disturbance) -> "Drift":
        """Return the drift of a momentum h, shape (3,), and a disturbance."""
        drift = cls(momentum, disturbance.slope, disturbance.imbalance)
        return NO_DRIFT if drift.is_zero else drift

    @property
    def disturbance(self) -> Disturbance:
        """Slope and imbalance."""
        return Disturbance(self.slope, self.imbalance)


NO_DRIFT = Drift()
"""Drift of the paper's model."""
