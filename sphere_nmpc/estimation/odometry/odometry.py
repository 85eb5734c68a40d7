# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Odometry of the sphere from inside: readings of an IMU and rotor speeds in, poses out.

Readings are taken together over short intervals, at whose ends the filter is updated. Intervals
are kept for a while, so that a pose which is measured elsewhere and arrives late is used at the
instant of its measurement: the filter begins anew there.
"""

import math
from bisect import bisect_left
from typing import NamedTuple

import numpy as np

from sphere_nmpc.conditions import Condition, Kind
from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry.inertial_filter import ROLL, InertialFilter
from sphere_nmpc.estimation.odometry.inertial_state import (
    GYRO_BIAS,
    PHI,
    POSE_ERROR,
    Belief,
    Samples,
)
from sphere_nmpc.estimation.odometry.placement import LEAST_DEVIATION, initial_belief, placed
from sphere_nmpc.estimation.odometry.pose_history import Fix, PoseHistory
from sphere_nmpc.estimation.odometry.rest import MOST_NOISE, RestDetector
from sphere_nmpc.estimation.odometry.rotor_speeds import RotorSpeeds
from sphere_nmpc.estimation.odometry.sensor_faults import SensorFaults
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers, OdometrySettings
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector, as_state
from sphere_nmpc.model.units import RobotUnits


class PoseEstimate(NamedTuple):
    """Pose and velocity at the instant of a reading.

    Attributes
    ----------
    time : float
        Control time of the newest reading [s].
    pose : ndarray, shape (6,)
        Position [m] and quaternion wxyz, body to world.
    covariance : ndarray, shape (5, 5)
        Of the error [dx, dy, a1, a2, a3]: position [m; world frame], rotation [rad; body frame].
    velocity : ndarray, shape (3,)
        Of the centre [m/s; world frame].
    body_rate : ndarray, shape (3,)
        Angular velocity [rad/s; body frame].
    twist_covariance : ndarray, shape (6, 6)
        Of linear [m/s] and angular velocity [rad/s], both in the body frame.
    """

    time: float
    pose: Vector
    covariance: Vector
    velocity: Vector
    body_rate: Vector
    twist_covariance: Vector


class Odometry:
    """Estimator of the pose from an IMU in the shell and the rotors' encoders.

    Until the sphere has been at rest for `calibration_time` there is no estimate. Times are those
    of measurement [s; control time].

    Parameters
    ----------
    settings : OdometrySettings
        Start, and what is known of robot and fixes.
    imu : ImuSettings
        Mounting and errors of the IMU.
    robot : RobotParameters
        Robot as built.
    """

    def __init__(
        self, settings: OdometrySettings, imu: ImuSettings, robot: RobotParameters
    ) -> None:
        self._settings = settings
        self._numbers = OdometryNumbers().of(RobotUnits.of(robot))
        self._filter = InertialFilter(imu, robot, self._numbers, settings.pivoting)
        self._imu = self._filter.imu
        self._robot = robot
        self.faults = SensorFaults(imu, self._numbers)
        """Faults of the sensors, and what has happened to the sphere."""
        self.fixes_used = self.fixes_left_out = 0
        """Numbers of fixes since the start."""
        self.calibration = ""
        """Biases that were found at rest, in one line; "" before."""
        given = as_state(settings.initial_state)
        self._given = Fix(-math.inf, given, self._covariance(given, None))
        self._begin()

    def _begin(self) -> None:
        """Begin anew without readings."""
        self._belief: Belief | None = None
        self._open = Samples([], [], [], [])
        numbers, settings, robot = self._numbers, self._settings, self._robot
        self._history = PoseHistory(
            self._filter, settings.fix_memory, numbers.improbable, numbers.most_outliers
        )
        self._speeds = RotorSpeeds(numbers.silence, robot.max_rotor_acceleration)
        self._rest = RestDetector(self._filter, robot.lumped.input_gain, numbers)
        self._pending: list[Fix] = []
        self._head: Vector = self._given.pose
        self._rate = np.zeros(3)
        self._was_still = False
        self._still_since = math.nan
        self.is_calibrated = False

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The present conditions, the worst first."""
        if not self.is_calibrated and self._open.times:
            needed = f"{self._settings.calibration_time:g} s"
            text = f"given no rest of {needed} yet, expected the robot to be left alone for it"
            return (Condition(Kind.CALIBRATING, text), *self.faults.conditions)
        return self.faults.conditions

    @property
    def is_lost(self) -> bool:
        """Whether the position is not known until a pose is given."""
        return self.faults.is_lost

    @property
    def estimate(self) -> PoseEstimate | None:
        """The pose at the newest reading; None before the calibration."""
        belief = self._belief
        if belief is None or not self.is_calibrated:
            return None
        turn = rotation.matrix(self._head[QUATERNION])
        to_body = np.eye(5)
        to_body[2:, 2:] = turn.T
        rolls = self._filter.rolled(belief) * ROLL
        spread = belief.covariance[GYRO_BIAS, GYRO_BIAS]
        spread = spread + np.eye(3) * self._imu.gyro_noise**2 / self._numbers.interval
        by = np.vstack((turn.T @ rolls @ turn, np.eye(3)))
        return PoseEstimate(
            self._open.times[-1], self._head,
            to_body @ belief.covariance[POSE_ERROR, POSE_ERROR] @ to_body.T,
            rolls @ (turn @ self._rate), self._rate, by @ spread @ by.T,
        )

    @property
    def gyro_bias(self) -> Vector:
        """Bias of the gyro [rad/s; axes of the sensor], shape (3,)."""
        return np.zeros(3) if self._belief is None else self._belief.value(GYRO_BIAS)

    @property
    def radius(self) -> float:
        """Radius of the shell as estimated [m]; fixes show it."""
        return self._filter.radius if self._belief is None else self._filter.rolled(self._belief)

    def observe_imu(self, time: float, rate: Vector, force: Vector) -> bool:
        """Take a reading: angular velocity [rad/s] and specific force [m/s^2], axes of the sensor.

        Return whether there is a new estimate. A reading that is not newer than the last one is
        left out.
        """
        if not (math.isfinite(time) and np.isfinite(rate).all() and np.isfinite(force).all()):
            raise InvalidInputError("IMU", [time, *rate, *force], "finite numbers")
        if self._open.times and time > self._open.times[-1] + self._numbers.interval:
            self._bridge(time)
        return self._take(time, np.asarray(rate, float), np.asarray(force, float), True)

    def observe_rotors(self, time: float, speeds: Vector, angles: Vector | None = None) -> bool:
        """Take speeds [rad/s] and, where known, angles [rad] of the rotors, shape (2,) each.

        Return whether there is a new estimate: without an IMU that moves by the rotors alone.
        """
        if not (math.isfinite(time) and np.isfinite(speeds).all()):
            raise InvalidInputError("rotor speeds", [time, *speeds], "finite numbers")
        if self.faults.rotors(time, speeds, angles):
            self._speeds.clear()
        if not self._speeds.append(time, np.asarray(speeds, float)):
            return False
        newest = self._open.times[-1] if self._open.times else math.nan
        if time > newest + self._numbers.silence and self.is_calibrated:
            self.faults.see(Kind.IMU_SILENT, time, f"given none for {time - newest:.2f} s")
            self._bridge(math.inf)
            return True
        self._close_if_due()
        return False

    def _bridge(self, until: float) -> None:
        """Move by the rotors since the newest reading, up to a time [s]."""
        held = self._open
        newest, rate, force = held.times[-1], held.rates[-1], held.forces[-1]
        for stamp in [stamp for stamp in self._speeds.times if newest < stamp < until]:
            self._take(stamp, rate, force, False)

    def set_pose(self, time: float, pose: Vector, covariance: Vector | None) -> None:
        """Place the sphere, at the newest reading.

        `covariance`, shape (5, 5), is that of `PoseEstimate`, None where it is not known. Where
        the tilt has a variance of 0, as RViz sends it, or is contradicted by gravity, position
        and heading are taken alone.
        """
        pose = as_state(pose)
        given = Fix(time, pose, self._covariance(pose, covariance))
        if self._belief is None:
            self._given = given
            return
        self._close()
        vertical = rotation.vertical(self._belief.pose[QUATERNION])
        tilt = slice(PHI.start, PHI.start + 2)
        spread = self._belief.deviation(tilt)
        self._belief = self._placed(self._belief, given, vertical, spread)
        self._history.clear()
        self.faults.placed()
        self._head = self._belief.pose

    def correct(self, time: float, pose: Vector, covariance: Vector | None) -> Condition | None:
        """Take a pose that was measured elsewhere at `time` [s]; see `set_pose`.

        Return why it is not used, or None. One that is ahead of the readings waits for them.
        """
        pose = as_state(pose)
        if not math.isfinite(time):
            raise InvalidStateError("time of the fix", time, "a finite number [s]")
        fix = Fix(time, pose, self._covariance(pose, covariance))
        if self._belief is None:
            return self._left_out("given a fix before the first reading of the IMU")
        newest = self._open.times[-1]
        if time > newest + self._settings.fix_memory:
            return self._left_out(
                f"given a stamp {time - newest:.3g} s ahead of the newest reading of the IMU, "
                "expected the clock of the IMU"
            )
        oldest = min(self._history.oldest, self._open.times[0])
        if time < max(oldest, newest - self._settings.fix_memory):
            return self._left_out(
                f"given a fix {newest - time:.3g} s old, expected at most "
                f"{min(newest - oldest, self._settings.fix_memory):.3g} s (fix_memory)"
            )
        if time > self._open.times[0]:
            self._pending.append(fix)
            return None
        return self._use(fix)

    def check(self, time: float) -> None:
        """Notice sensors that are silent at control time `time` [s]."""
        newest = self._open.times[-1] if self._open.times else -math.inf
        if time > newest + self._numbers.silence:
            given = "given none" if newest < 0.0 else f"given none for {time - newest:.2f} s"
            self.faults.see(Kind.IMU_SILENT, time, given)
        if not self._speeds.reach(time - self._numbers.silence):
            self.faults.see(Kind.ENCODERS_SILENT, time, "rest and pushes cannot be told")
        self.faults.forget_before(time - self._numbers.remembered)

    def forget(self) -> None:
        """Discard all readings, as after a jump of the clock; the pose stays."""
        if self._belief is not None:
            world = self._belief.covariance[POSE_ERROR, POSE_ERROR]
            self._given = Fix(-math.inf, self._head, world)
        self._begin()

    def _covariance(self, pose: Vector, covariance: Vector | None) -> Vector:
        """Return the covariance of a given pose in the world frame."""
        given = self._settings
        if covariance is None:
            deviations = [given.position_deviation] * 2 + [given.orientation_deviation] * 3
            covariance = np.diag(np.square(deviations))
        turn = np.eye(5)
        turn[2:, 2:] = rotation.matrix(pose[QUATERNION])
        found: Vector = turn @ covariance @ turn.T + LEAST_DEVIATION**2 * np.eye(5)
        return found

    def _left_out(self, text: str) -> Condition:
        self.fixes_left_out += 1
        return Condition(Kind.FIX_LEFT_OUT, text)

    def _take(self, time: float, rate: Vector, force: Vector, usable: bool) -> bool:
        """Append a sample to the open interval, move the pose by it, and close it where due."""
        samples = self._open
        if samples.times and time <= samples.times[-1]:
            return False
        if usable:
            usable = self.faults.reading(time, rate, force)
        samples.valid.append(usable)
        samples.times.append(time)
        samples.rates.append(rate)
        samples.forces.append(force)
        self._advance_head(len(samples.times) - 1)
        self._close_if_due()
        return self.is_calibrated

    def _advance_head(self, last: int) -> None:
        """Move the pose by the readings up to one of the open interval."""
        belief, samples = self._belief, self._open
        if belief is None or last == 0:
            return
        pair = self._rates(belief, samples, last - 1)
        step, self._rate = samples.times[last] - samples.times[last - 1], pair[1]
        if self._was_still and self._is_slow(pair[1], step):
            self._rate = np.zeros(3)
            return
        radius = self._filter.rolled(belief)
        self._head, _ = self._filter.moved(self._head, 0.5 * (pair[0] + pair[1]) * step, radius)

    def _rates(self, belief: Belief, samples: Samples, first: int) -> Vector:
        """Return the angular velocities of two readings [rad/s; body frame], shape (2, 3)."""
        speeds = self._speeds.newest
        if all(samples.valid[first : first + 2]) or speeds is None:
            return self._filter.body_rates(belief, np.array(samples.rates[first : first + 2]))
        turn = rotation.matrix(self._head[QUATERNION])
        rate = self._filter.model_rate(belief, turn, speeds)[0]
        return np.array((rate, rate))

    def _is_slow(self, rate: Vector, step: float) -> bool:
        """Return whether an angular velocity may be noise of the gyro at rest."""
        return float(rate @ rate) < (MOST_NOISE * self._imu.gyro_noise) ** 2 / step

    def _close_if_due(self) -> None:
        """End the open interval where it is long enough and the speeds of the rotors are there."""
        times, numbers = self._open.times, self._numbers
        due = times[0] + numbers.interval * (1.0 - 1e-6) if times else math.inf
        if not times or times[-1] < due:
            return
        end = bisect_left(times, due)
        # A reading further, as the acceleration is that of the speeds before and after.
        step = (times[end] - times[0]) / end
        late = 0.0 if self._belief is None else self._belief.late
        is_known = self._speeds.reach(times[end] + late + 0.9 * step)
        if is_known or times[-1] > times[end] + numbers.silence:
            self._close(end)

    def _close(self, end: int = -1) -> None:
        """End the open interval at one of its readings; the others begin the next one."""
        whole = self._open
        end = len(whole.times) - 1 if end < 0 else end
        if end < 1:
            return
        before, after = whole.part(slice(0, end + 1)), whole.part(slice(end, None))
        belief = self._belief or self._started(before)
        samples = self._speeds.added_to(before, belief.late)
        samples = samples._replace(still=self._rest.is_at_rest(belief, samples))
        self._history.append(belief, samples)
        self._belief, findings = self._filter.advance(belief, samples)
        self._open, self._was_still = after, samples.still
        self.faults.interval(samples, findings, self._belief)
        self._calibrate(samples, self._belief)
        due = [fix for fix in self._pending if fix.time <= samples.times[-1]]
        self._pending = [fix for fix in self._pending if fix.time > samples.times[-1]]
        for fix in due:
            self._use(fix)
        self._follow_readings()
        self._speeds.forget_before(samples.times[0] - 2.0 * self._numbers.interval)

    def _follow_readings(self) -> None:
        """Move the pose by the readings since the last interval."""
        if self._belief is not None:
            self._head = self._belief.pose
            for last in range(1, len(self._open.times)):
                self._advance_head(last)

    def _started(self, samples: Samples) -> Belief:
        """Return the belief in the given pose, with the tilt that gravity shows."""
        imu = self._imu
        force = imu.turn @ np.mean(samples.forces, axis=0)
        vertical = force / max(float(np.linalg.norm(force)), 1e-3)
        belief = initial_belief(self._given.pose, imu, self._settings, self._numbers)
        return self._placed(belief, self._given, vertical, imu.accelerometer_bias / GRAVITY)

    def _placed(self, belief: Belief, given: Fix, vertical: Vector, spread: float) -> Belief:
        """Return the belief of a sphere that is put at a given pose, and note a replaced tilt."""
        found, contradiction = placed(belief, given, vertical, spread)
        if contradiction:
            self.faults.see(Kind.TILT_REPLACED, given.time, contradiction)
        return found

    def _calibrate(self, samples: Samples, belief: Belief) -> None:
        """Note that the sphere rests, and for how long."""
        if self.is_calibrated:
            return
        if not samples.still and self._settings.calibration_time > 0.0:
            self._still_since = math.nan
            return
        if math.isnan(self._still_since):
            self._still_since = samples.times[0]
        rested = samples.times[-1] - self._still_since
        if rested >= self._settings.calibration_time * (1.0 - 1e-6):
            self.is_calibrated = True
            bias = ", ".join(f"{math.degrees(one):.3f}" for one in belief.value(GYRO_BIAS))
            left = math.sqrt(float(np.trace(belief.covariance[GYRO_BIAS, GYRO_BIAS])) / 3.0)
            self.calibration = (
                f"gyro bias [{bias}] deg/s +- {math.degrees(left):.3f}, {rested:.1f} s at rest"
            )

    def _use(self, fix: Fix) -> Condition | None:
        """Use a fix at the instant of its measurement; return why it is not."""
        found = self._history.use(fix)
        if isinstance(found, str):
            self.faults.see(Kind.FIX_LEFT_OUT, fix.time, found)
            return self._left_out(found)
        self.fixes_used += 1
        self.faults.placed()
        self._belief = found
        self._follow_readings()
        return None
