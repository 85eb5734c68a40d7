# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the odometry begins: a given pose, with the tilt that gravity shows."""

import math
from typing import NamedTuple

import numpy as np

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry.inertial_state import (
    ARM,
    BY_FORCE,
    CONSTANTS,
    FIRST,
    FORCE_BIAS,
    FORCE_MATRIX,
    GYRO_BIAS,
    GYRO_MATRIX,
    MOMENTUM,
    OFFSET,
    RADIUS,
    SIZE,
    Belief,
)
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers, OdometrySettings
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.state import QUATERNION, Vector

LEAST_DEVIATION = 1e-6
"""Least standard deviation of a given pose [m, rad], for which its covariance stays regular."""
MOST_VARIANCE = (1e6, math.pi**2)
"""Largest variances of a given position [m^2] and rotation [rad^2]: more is not known at all."""
_NEARLY = 0.2
"""Angle within which a vertical is the opposite one [rad]."""
_OPPOSITE = "; or has the accelerometer the opposite sign?"
_CONTRADICTED = 6.0
"""Standard deviations [-] by which a given tilt may differ from that which gravity shows."""


class Fix(NamedTuple):
    """A pose that was measured elsewhere."""

    time: float
    """Time of measurement [s]."""
    pose: Vector
    """Position [m] and quaternion wxyz, shape (6,)."""
    covariance: Vector
    """Of the error in the world frame, shape (5, 5)."""
    replaces: bool = False
    """Whether it replaces the pose rather than being averaged with it."""


def initial_belief(
    pose: Vector, imu: ImuSettings, settings: OdometrySettings, numbers: OdometryNumbers,
    late: float, rate: Vector,
) -> Belief:
    """Return what is known of sensors and robot before the first reading, with an exact pose.

    `late` is the expected offset of stamps [s], `rate` the mean rate at rest [rad/s], shape (3,),
    which may be a bias larger than expected.
    """
    variances: Vector = np.zeros(SIZE)
    variances[GYRO_BIAS] = imu.gyro_bias**2 + rate**2
    variances[FORCE_BIAS] = imu.accelerometer_bias**2
    cross = np.full((3, 3), imu.cross_axis**2)
    for part, scale in ((GYRO_MATRIX, imu.gyro_scale), (FORCE_MATRIX, imu.accelerometer_scale)):
        np.fill_diagonal(cross, scale**2)
        variances[part] = cross.ravel()
    variances[BY_FORCE], variances[ARM] = imu.g_sensitivity**2, imu.position_deviation**2
    variances[MOMENTUM], variances[CONSTANTS] = numbers.push**2, settings.constants_deviation**2
    variances[RADIUS], variances[OFFSET] = settings.radius_deviation**2, numbers.offset**2
    covariance = np.diag(variances)
    # A mounting that is turned by m: both sensors show (I - [m]x) of what there is.
    by = np.zeros((SIZE, 3))
    for axis, unit in enumerate(np.eye(3)):
        turned = np.cross(unit, np.eye(3))  # its rows are the columns of the matrix, so of [m]x^T
        by[GYRO_MATRIX, axis] = by[FORCE_MATRIX, axis] = turned.ravel()
    covariance += imu.orientation_deviation**2 * by @ by.T
    values: Vector = np.zeros(SIZE - FIRST)
    values[OFFSET - FIRST] = late
    return Belief(pose, values, covariance, np.zeros(3), np.zeros(3))


def tilt_deviation(imu: ImuSettings) -> float:
    """Return the standard deviation of a tilt that is measured by gravity alone [rad]."""
    return math.hypot(
        imu.accelerometer_bias / GRAVITY, imu.orientation_deviation, imu.cross_axis,
        imu.accelerometer_scale,
    )


def bounded(covariance: Vector) -> Vector:
    """Return a covariance, shape (5, 5), with variances that are not beyond what is unknown."""
    most = np.array([MOST_VARIANCE[0]] * 2 + [MOST_VARIANCE[1]] * 3)
    shrunk = np.sqrt(most / np.maximum(np.diag(covariance), most))
    # Larger ones first, as the products of others with them may overflow.
    found: Vector = shrunk[:, None] * covariance * shrunk
    return found


def has_tilt(covariance: Vector) -> bool:
    """Return whether a pose with a covariance, (5, 5), has a tilt: RViz and AMCL send 0 for it."""
    return float(np.trace(covariance[2:4, 2:4])) >= 4.0 * LEAST_DEVIATION**2


def with_vertical(given: Fix, vertical: Vector, tilt: Vector) -> Fix:
    """Return a given pose with a vertical in the body, (3,), and the covariance of that, (2, 2).

    The heading is that of the shortest rotation between both verticals.
    """
    stated = rotation.vertical(given.pose[QUATERNION])
    axis = np.cross(vertical, stated).astype(float)
    length = float(np.linalg.norm(axis))
    between = math.atan2(length, float(stated @ vertical))
    if length < 1e-9:
        axis, length = np.array((1.0, 0.0, 0.0)), 1.0
    q = rotation.product(given.pose[QUATERNION], rotation.exponential(axis * (between / length)))
    covariance = given.covariance.copy()
    covariance[2:4, :] = covariance[:, 2:4] = 0.0
    covariance[2:4, 2:4] = tilt
    pose = np.concatenate((given.pose[:2], q / math.sqrt(float(q @ q))))
    return given._replace(pose=pose, covariance=covariance)


def contradiction(given: Fix, vertical: Vector, spread: float) -> tuple[str, bool]:
    """Return in one line how gravity contradicts the tilt of a given pose, "" where it does not.

    Also whether it is the opposite, as with an accelerometer of the other sign.

    `vertical` is that in the body frame as gravity shows it, shape (3,), and `spread` its standard
    deviation [rad].
    """
    stated = rotation.vertical(given.pose[QUATERNION])
    between = math.atan2(float(np.linalg.norm(np.cross(vertical, stated))), stated @ vertical)
    known = float(np.trace(given.covariance[2:4, 2:4]))
    allowed = _CONTRADICTED * math.sqrt(known + spread**2)
    if between <= allowed or not has_tilt(given.covariance):
        return "", False
    is_opposite = between > math.pi - _NEARLY
    return (
        f"given a pose whose vertical is {math.degrees(between):.1f} deg from that "
        f"of the accelerometer, expected at most {math.degrees(allowed):.1f} deg; "
        f"position and heading are taken{_OPPOSITE if is_opposite else ''}"
    ), is_opposite
