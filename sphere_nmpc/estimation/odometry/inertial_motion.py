# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motion of the shell by readings whose errors are estimated, and its derivatives by these."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sphere_nmpc.estimation.odometry.inertial_state import (
    BY_FORCE,
    FORCE_BIAS,
    FORCE_MATRIX,
    GYRO_BIAS,
    GYRO_MATRIX,
    SIZE,
    Belief,
)
from sphere_nmpc.model.state import Vector


class SensorMap(NamedTuple):
    """Affine map of readings to what they measure, by the errors of the sensors."""

    rate: Vector
    """Body rate by rate and force as measured, shape (3, 6)."""
    rate_at_zero: Vector
    """Body rate [rad/s] at readings of 0, shape (3,)."""
    force: Vector
    """Specific force by that as measured, both in the axes of the sensor, shape (3, 3)."""
    force_at_zero: Vector
    """Specific force [m/s^2] at readings of 0, shape (3,)."""
    turn: Vector
    """Matrix that takes axes of the sensor, as mounted, to the body frame, shape (3, 3)."""

    def rates(self, rates: Vector, forces: Vector) -> Vector:
        """Return the body rates [rad/s] of readings, shape (n, 3)."""
        found: Vector = np.hstack((rates, forces)) @ self.rate.T + self.rate_at_zero
        return found

    def forces(self, forces: Vector) -> Vector:
        """Return the specific forces [m/s^2; axes of the sensor] of readings, shape (n, 3)."""
        found: Vector = forces @ self.force.T + self.force_at_zero
        return found


def sensor_map(belief: Belief, turn: Vector) -> SensorMap:
    """Return how readings are corrected; `turn` takes axes of the sensor to the body."""
    gyro = turn @ np.linalg.inv(np.eye(3) + belief.value(GYRO_MATRIX).reshape(3, 3))
    force = np.linalg.inv(np.eye(3) + belief.value(FORCE_MATRIX).reshape(3, 3))
    at_zero = -force @ belief.value(FORCE_BIAS)
    by_force = gyro @ belief.value(BY_FORCE).reshape(3, 3)
    rate_at_zero = -gyro @ belief.value(GYRO_BIAS) - by_force @ at_zero
    rates = np.hstack((gyro, -by_force @ force))
    return SensorMap(rates, rate_at_zero, np.asarray(force, float), at_zero, turn)


@dataclass(frozen=True, eq=False)
class Motion:
    """How the shell has moved in an interval, at its n + 1 readings."""

    pose: Vector
    """Pose at the end, shape (6,)."""
    turns: Vector
    """Orientations, body to world, shape (n + 1, 3, 3)."""
    rates: Vector
    """Angular velocities [rad/s; body frame], shape (n + 1, 3)."""
    forces: Vector
    """Specific forces [m/s^2; axes of the sensor], shape (n + 1, 3)."""
    times: Vector
    """Times of the readings [s], shape (n + 1,)."""
    weights: Vector
    """Weights of the readings in an integral [s], shape (n + 1,)."""
    sensor: SensorMap
    """How the readings have been corrected."""

    def rate_errors(self, forces: Vector) -> Vector:
        """Return the derivatives of the body rates by the error, shape (n + 1, 3, 49).

        `forces`, shape (n + 1, 3), are the specific forces [m/s^2].
        """
        gyro = self.sensor.rate[:, :3]
        found: Vector = np.zeros((len(self.rates), 3, SIZE))
        found[:, :, GYRO_BIAS] = -gyro
        turned = self.rates @ self.sensor.turn
        for part, factors in ((GYRO_MATRIX, turned), (BY_FORCE, forces)):
            found[:, :, part] = -np.einsum("ai,kj->kaij", gyro, factors).reshape(-1, 3, 9)
        return found

    @cached_property
    def turned(self) -> Vector:
        """Errors of the orientation since the start by that at the start, (n + 1, 3, 49)."""
        by = self.turns @ self.rate_errors(self.forces)
        found: Vector = np.zeros(by.shape)
        steps = 0.5 * np.diff(self.times)[:, None, None] * (by[1:] + by[:-1])
        np.cumsum(steps, axis=0, out=found[1:])
        return found


def cross(vector: Vector) -> Vector:
    """Return the matrix of the cross product with a vector, shape (3, 3)."""
    x, y, z = vector.tolist()
    return np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))


def crosses(vectors: Vector) -> Vector:
    """Return the matrices of the cross products with vectors, (n, 3, 1), shape (n, 3, 3)."""
    x, y, z = vectors[:, :, 0].T
    zero = np.zeros(len(vectors))
    return np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=1).reshape(-1, 3, 3)
