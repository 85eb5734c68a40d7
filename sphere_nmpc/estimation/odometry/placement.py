# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the odometry begins: a given pose, with the tilt that gravity shows."""

import math

import numpy as np

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry.inertial_state import (
    CONSTANTS,
    FIRST,
    FORCE_BIAS,
    FORCE_SCALE,
    GYRO_BIAS,
    GYRO_SCALE,
    MOMENTUM,
    OFFSET,
    RADIUS,
    SIZE,
    Belief,
    replaced,
)
from sphere_nmpc.estimation.odometry.pose_history import Fix
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers, OdometrySettings
from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import QUATERNION, Vector

LEAST_DEVIATION = 1e-6
"""Least standard deviation of a given pose [m, rad], for which its covariance stays regular."""
_CONTRADICTED = 6.0
"""Standard deviations [-] by which a given tilt may differ from that which gravity shows."""


def initial_belief(
    pose: Vector, imu: ImuSettings, settings: OdometrySettings, numbers: OdometryNumbers
) -> Belief:
    """Return what is known of sensors and robot before the first reading, with an exact pose."""
    deviations: Vector = np.zeros(SIZE)
    deviations[GYRO_BIAS], deviations[GYRO_SCALE] = imu.gyro_bias, imu.gyro_scale
    deviations[FORCE_BIAS] = imu.accelerometer_bias
    deviations[FORCE_SCALE] = imu.accelerometer_scale
    deviations[MOMENTUM], deviations[CONSTANTS] = numbers.push, settings.constants_deviation
    deviations[RADIUS], deviations[OFFSET] = settings.radius_deviation, numbers.offset
    return Belief(pose, np.zeros(SIZE - FIRST), np.diag(deviations**2), np.zeros(3))


def placed(belief: Belief, given: Fix, vertical: Vector, spread: float) -> tuple[Belief, str]:
    """Return the belief of a sphere that is put at a given pose, and what gravity contradicts.

    `vertical` is that in the body frame as gravity shows it, shape (3,), and `spread` its standard
    deviation [rad]. Where the given tilt is unknown, with a variance of 0, or contradicted, which
    is told in one line, position and heading are taken alone.
    """
    pose, covariance = given.pose, given.covariance
    stated = rotation.vertical(pose[QUATERNION])
    tilt = float(np.trace(covariance[2:4, 2:4]))
    axis = np.cross(vertical, stated).astype(float)
    length = float(np.linalg.norm(axis))
    between = math.atan2(length, float(stated @ vertical))
    contradiction, is_unknown = "", tilt < 4.0 * LEAST_DEVIATION**2
    allowed = _CONTRADICTED * math.sqrt(tilt + spread**2)
    if is_unknown or between > allowed:
        if not is_unknown:
            contradiction = (
                f"given a pose whose vertical is {math.degrees(between):.1f} deg from that "
                f"of the accelerometer, expected at most {math.degrees(allowed):.1f} deg; "
                "position and heading are taken"
            )
        if length < 1e-9:
            axis, length = np.array((1.0, 0.0, 0.0)), 1.0
        turn = rotation.exponential(axis * (between / length))
        q = rotation.product(pose[QUATERNION], turn)
        pose = np.concatenate((pose[:2], q / math.sqrt(float(q @ q))))
        covariance = covariance.copy()
        covariance[2:4, :] = covariance[:, 2:4] = 0.0
        covariance[2, 2] = covariance[3, 3] = spread**2
    return replaced(belief, pose, covariance), contradiction
