# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""State of the odometry: the parts of its error, its distribution, and readings of an interval.

The error is

    [p, phi, b_g, b_a, E_g, E_a, G, r, h, c, rho, tau]

position [m] and rotation [rad] in the world frame, true minus estimated, R_true = exp(phi) R, with
which the model, which no motion of the plane changes, is linear in the unobservable position and
heading; the errors of a device, in the axes of the sensor, whose readings of the angular velocity
w and the specific force f are

    (I + E_g) w + G f + b_g    and    (I + E_a) f + b_a,

biases, matrices of scales and of what crosses to other axes, and the sensitivity of a gyro to
force; a mounting that is turned is in both matrices, whose errors are correlated by it; the place
r of the IMU; momentum over I1 [rad/s; world frame], which turns with phi as well, h_true =
exp(phi) (h + dh); relative errors of c1, r1, r3 and of the radius; and the time by which the
stamps of the rotors' speeds are late [s].

Both readings are values at the same instants, as a device filters both alike: its delay is one of
the stamps.
"""

import math
from typing import NamedTuple

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.error_state import POSE_ERROR, with_block
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector

P, PHI, GYRO_BIAS, FORCE_BIAS = slice(0, 2), slice(2, 5), slice(5, 8), slice(8, 11)
GYRO_MATRIX, FORCE_MATRIX, BY_FORCE = slice(11, 20), slice(20, 29), slice(29, 38)
ARM, MOMENTUM, CONSTANTS, RADIUS, OFFSET, SIZE = (
    slice(38, 41), slice(41, 44), slice(44, 47), 47, 48, 49,
)
"""Places in the error; matrices are there by rows."""
FIRST = POSE_ERROR.stop
"""Size of the error of the pose, behind which the error is one of numbers."""


class Belief(NamedTuple):
    """Distribution of the state at one instant."""

    pose: Vector
    """Shape (6,)."""
    numbers: Vector
    """All that is behind the pose in the error, shape (44,)."""
    covariance: Vector
    """Covariance of the error, shape (49, 49)."""
    unexplained: Vector
    """Change of velocity that rolling has not explained recently [m/s; world], shape (3,)."""
    vibration: Vector
    """Variance of velocities by the vibration of shell and floor [m^2/s^2; world], shape (3,)."""
    height: float = 0.0
    """Vertical way that rolling has not explained recently [m]."""
    slipping: int = 0
    """Intervals in a row whose force rolling does not explain: a bump takes some."""

    def value(self, part: slice) -> Vector:
        """Return a part of the numbers by its place in the error."""
        return self.numbers[part.start - FIRST : part.stop - FIRST]

    @property
    def late(self) -> float:
        """Time by which the stamps of the rotors' speeds are late [s]."""
        return float(self.numbers[OFFSET - FIRST])

    def deviation(self, part: slice) -> float:
        """Return the standard deviation of the least certain number of a part of the error."""
        return math.sqrt(float(np.max(np.diag(self.covariance)[part])))


class Findings(NamedTuple):
    """What an interval has shown beside the state."""

    force: float
    """Normalised square of the innovation of the specific force; nan where it was not used."""
    rate: float
    """Normalised square of that of the rate by the rotors; nan without rotor speeds."""
    jump: Vector
    """Innovation of the velocity [m/s; world frame], shape (3,)."""


class Samples(NamedTuple):
    """Readings of an interval, from its start to its end, and speeds of the rotors at these."""

    times: list[float]
    """Times [s], n + 1 of them."""
    rates: list[Vector]
    """Angular velocities [rad/s; axes of the sensor], each of shape (3,)."""
    forces: list[Vector]
    """Specific forces [m/s^2; axes of the sensor], each of shape (3,)."""
    valid: list[bool]
    """Whether gyro and accelerometer can be believed."""
    speeds: Vector | None = None
    """Speeds of the rotors [rad/s], shape (n + 1, 2); None where they are not known."""
    bend: float = 0.0
    """Second differences of these speeds: root of their sum of squares [rad/s]."""
    still: bool = False
    """Whether the shell is at rest."""

    @property
    def usable(self) -> bool:
        """Whether all readings can be believed."""
        return all(self.valid)

    @property
    def duration(self) -> float:
        """Length of the interval [s]."""
        return self.times[-1] - self.times[0]

    @property
    def step(self) -> float:
        """Mean time between two readings [s]."""
        return self.duration / (len(self.times) - 1)

    @property
    def weights(self) -> Vector:
        """Weights of the readings in an integral over the interval [s], shape (n + 1,)."""
        steps = np.diff(self.times)
        return 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps))

    def part(self, which: slice) -> "Samples":
        """Return some of the readings in a row."""
        speeds = None if self.speeds is None else self.speeds[which]
        return self._replace(
            times=self.times[which], rates=self.rates[which], forces=self.forces[which],
            valid=self.valid[which], speeds=speeds,
        )


def replaced(belief: Belief, pose: Vector, covariance: Vector) -> Belief:
    """Return a belief at another pose, with the covariance of its error, shape (5, 5)."""
    changed = with_block(belief.covariance, POSE_ERROR, covariance)
    return belief._replace(pose=pose, covariance=changed, unexplained=np.zeros(3), height=0.0)


def applied(pose: Vector, error: Vector) -> Vector:
    """Return a pose, shape (6,), changed by an error in the world frame, shape (5,)."""
    q = rotation.product(rotation.exponential(error[2:]), pose[QUATERNION])
    return np.concatenate((pose[POSITION] + error[:2], q / math.sqrt(float(q @ q))))
