# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the odometry says of pose and velocity, and how certain it is."""

import math
from typing import NamedTuple

import numpy as np

from sphere_nmpc.estimation.odometry.inertial_filter import ROLL, InertialFilter
from sphere_nmpc.estimation.odometry.inertial_state import GYRO_BIAS, Belief
from sphere_nmpc.model import rotation
from sphere_nmpc.model.error_state import POSE_ERROR
from sphere_nmpc.model.state import QUATERNION, Vector


class PoseEstimate(NamedTuple):
    """Pose and velocity at the instant of a reading."""

    time: float
    """Control time of the newest reading [s]."""
    pose: Vector
    """Position [m] and quaternion wxyz, body to world, shape (6,)."""
    covariance: Vector
    """Covariance of the error [dx, dy, a1, a2, a3], shape (5, 5): position [m; world frame],
    rotation [rad; body frame]."""
    velocity: Vector
    """Velocity of the centre [m/s; world frame], shape (3,)."""
    body_rate: Vector
    """Angular velocity [rad/s; body frame], shape (3,)."""
    twist_covariance: Vector
    """Covariance of linear [m/s] and angular velocity [rad/s; body frame], shape (6, 6)."""

    @property
    def deviations(self) -> tuple[float, float, float]:
        """Standard deviations of position [m], heading [rad] and tilt [rad]."""
        within, up = self.covariance, rotation.vertical(self.pose[QUATERNION])
        heading = float(up @ within[2:, 2:] @ up)
        tilt = float(np.trace(within[2:, 2:])) - heading
        place = float(np.trace(within[:2, :2]))
        return math.sqrt(place), math.sqrt(max(heading, 0.0)), math.sqrt(max(tilt, 0.0))


def pose_estimate(
    inertial: InertialFilter, belief: Belief, time: float, rate: Vector,
    delay: tuple[float, float], interval: float,
) -> PoseEstimate:
    """Return pose and velocity at a time [s], by a belief at the newest reading.

    That is of `delay` [s] before, which has a standard deviation [s]; the angular velocity `rate`
    [rad/s; body frame] moves it on, whose noise is that over `interval` [s].
    """
    late, spread = delay
    radius = inertial.rolled(belief)
    pose = inertial.moved(belief.pose, np.array((rate, rate)), late, radius)
    turn = rotation.matrix(pose[QUATERNION])
    to_body = np.eye(5)
    to_body[2:, 2:] = turn.T
    velocity = radius * ROLL @ (turn @ rate)
    moves = np.concatenate((velocity[:2], turn @ rate))
    within = belief.covariance[POSE_ERROR, POSE_ERROR] + spread**2 * np.outer(moves, moves)
    rates = belief.covariance[GYRO_BIAS, GYRO_BIAS]
    rates = rates + np.eye(3) * inertial.imu.gyro_noise**2 / interval
    by = np.vstack((turn.T @ (radius * ROLL) @ turn, np.eye(3)))
    return PoseEstimate(
        time, pose, to_body @ within @ to_body.T, velocity, rate, by @ rates @ by.T
    )
