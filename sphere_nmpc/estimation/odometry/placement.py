# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the odometry begins: a given pose, with the tilt that gravity shows."""

import math

import numpy as np

from sphere_nmpc.estimation.odometry.given_pose import (
    LEAST_DEVIATION,
    Fix,
    bounded,
    contradiction,
    has_tilt,
    with_vertical,
)
from sphere_nmpc.estimation.odometry.inertial_filter import InertialFilter
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
    PHI,
    RADIUS,
    SIZE,
    Belief,
    Samples,
    replaced,
)
from sphere_nmpc.estimation.odometry.sensor_faults import SensorFaults
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers, OdometrySettings
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.error_state import POSE_ERROR
from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_nmpc.reporting.conditions import Kind

_CONTRADICTED = 4.0
"""Improbable squares of a force at rest [-] at which the tilt is another one."""
_ANY_TILT = np.eye(2)
"""Covariance of a tilt before the force at rest shows it [rad^2]."""


class Placement:
    """Beliefs of a sphere at a given pose, whose tilt gravity may contradict, which is reported.

    Parameters
    ----------
    inertial : InertialFilter
        Filter, with the settings of the IMU.
    settings : OdometrySettings
        What is known of given poses and of the robot.
    numbers : OdometryNumbers
        What is improbable.
    faults : SensorFaults
        Where it is reported.
    """

    def __init__(
        self, inertial: InertialFilter, settings: OdometrySettings, numbers: OdometryNumbers,
        faults: SensorFaults,
    ) -> None:
        self._filter, self._settings = inertial, settings
        self._numbers, self._faults = numbers, faults
        imu = inertial.imu
        self._spread = math.hypot(
            imu.accelerometer_bias / GRAVITY, imu.orientation_deviation, imu.cross_axis,
            imu.accelerometer_scale,
        )
        """Standard deviation of a tilt that is measured by gravity alone [rad]."""

    def covariance(self, pose: Vector, covariance: Vector | None) -> Vector:
        """Return the covariance of a given pose in the world frame, shape (5, 5)."""
        given = self._settings
        if covariance is None:
            deviations = [given.position_deviation] * 2 + [given.orientation_deviation] * 3
            covariance = np.diag(np.square(deviations))
        turn = np.eye(5)
        turn[2:, 2:] = rotation.matrix(pose[QUATERNION])
        found: Vector = turn @ bounded(covariance) @ turn.T + LEAST_DEVIATION**2 * np.eye(5)
        return found

    def started(self, samples: Samples, given: Fix, late: float) -> Belief:
        """Return the belief in a given pose, with the tilt that gravity shows, at their end.

        `late` is the expected offset of stamps [s].
        """
        rate = samples.rates[0] if samples.still else np.zeros(3)
        belief = self._initial(given.pose, late, rate)
        vertical = self._filter.turn @ np.mean(samples.forces, axis=0)
        vertical = vertical / max(float(np.linalg.norm(vertical)), 1e-3)
        begun = given._replace(time=samples.times[-1])
        belief = self._at(belief, begun, (vertical, self._spread), (vertical, _ANY_TILT))
        # What the tilt was off is no vibration.
        return self._filter.advance(belief, samples)[0]._replace(vibration=np.zeros(3))

    def tilted(self, belief: Belief, samples: Samples, late: float) -> Belief | None:
        """Return the belief that begins anew where a lasting rest contradicts the tilt, or None.

        `samples` are a mean at rest.
        """
        square, between = self._filter.tilt_square(belief, samples)
        if square < _CONTRADICTED * self._numbers.improbable(3):
            return None
        self._faults.tilted(samples.times[-1], between)
        # What has turned it unnoticed may have turned it about the vertical, too.
        away = between * np.array([self._filter.radius] * 2 + [0.0, 0.0, 1.0])
        covariance = belief.covariance[POSE_ERROR, POSE_ERROR] + np.diag(away**2)
        return self.started(samples, Fix(samples.times[-1], belief.pose, covariance), late)

    def placed(self, belief: Belief, given: Fix, rested: Samples | None) -> Belief:
        """Return the belief of a sphere that is put at a given pose.

        `rested` is a mean at rest, None in motion.
        """
        vertical = rotation.vertical(belief.pose[QUATERNION])
        tilt = belief.covariance[PHI, PHI][:2, :2]
        shown, spread = vertical, math.sqrt(float(np.trace(tilt)))
        if rested is not None:
            # What is measured, and not what is believed, which may be what has to be mended.
            forces = self._filter.sensor(belief).forces(np.array(rested.forces))
            shown = self._filter.turn @ forces[0]
            shown, spread = shown / max(float(np.linalg.norm(shown)), 1e-3), self._spread
        return self._at(belief, given, (shown, spread), (vertical, tilt))

    def _at(
        self, belief: Belief, given: Fix, shown: tuple[Vector, float], taken: tuple[Vector, Vector]
    ) -> Belief:
        """Return the belief at a given pose, whose tilt may be unknown or contradicted.

        `shown` are the vertical by gravity and its deviation, `taken` are the vertical and the
        covariance of the tilt that take the place of the given ones then.
        """
        fault, is_opposite = contradiction(given, *shown)
        if fault:
            self._faults.see(Kind.TILT_REPLACED, given.time, fault)
        if is_opposite:
            self._faults.lost(given.time, fault)
        if fault or not has_tilt(given.covariance):
            given = with_vertical(given, *taken)
        return replaced(belief, given.pose, given.covariance)

    def _initial(self, pose: Vector, late: float, rate: Vector) -> Belief:
        """Return what is known of sensors and robot before the first reading, with an exact pose.

        `late` is the expected offset of stamps [s], `rate` the mean rate at rest [rad/s], shape
        (3,), which may be a bias larger than expected.
        """
        imu, settings, numbers = self._filter.imu, self._settings, self._numbers
        variances: Vector = np.zeros(SIZE)
        variances[GYRO_BIAS] = imu.gyro_bias**2 + rate**2
        variances[FORCE_BIAS] = imu.accelerometer_bias**2
        cross = np.full((3, 3), imu.cross_axis**2)
        scales = (GYRO_MATRIX, imu.gyro_scale), (FORCE_MATRIX, imu.accelerometer_scale)
        for part, scale in scales:
            np.fill_diagonal(cross, scale**2)
            variances[part] = cross.ravel()
        variances[BY_FORCE], variances[ARM] = imu.g_sensitivity**2, imu.position_deviation**2
        variances[MOMENTUM] = numbers.push**2
        variances[CONSTANTS] = settings.constants_deviation**2
        variances[RADIUS], variances[OFFSET] = settings.radius_deviation**2, numbers.offset**2
        covariance = np.diag(variances)
        # A mounting that is turned by m: both sensors show (I - [m]x) of what there is.
        by = np.zeros((SIZE, 3))
        for axis, unit in enumerate(np.eye(3)):
            # Its rows are the columns of the matrix, so of [m]x^T.
            turned = np.cross(unit, np.eye(3))
            by[GYRO_MATRIX, axis] = by[FORCE_MATRIX, axis] = turned.ravel()
        covariance += imu.orientation_deviation**2 * by @ by.T
        values: Vector = np.zeros(SIZE - FIRST)
        values[OFFSET - FIRST] = late
        return Belief(pose, values, covariance, np.zeros(3), np.zeros(3))
