# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Odometry of the sphere from inside: readings of an IMU and rotor speeds in, poses out.

Readings are taken together over short intervals, at whose ends the filter is updated. Intervals
are kept for a while, so that a pose which is measured elsewhere and arrives late is used at the
instant of its measurement: the filter begins anew there.
"""

import math
from bisect import bisect_left

import numpy as np

from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry.given_pose import Fix
from sphere_nmpc.estimation.odometry.inertial_filter import InertialFilter
from sphere_nmpc.estimation.odometry.inertial_state import (
    GYRO_BIAS,
    Belief,
    Samples,
)
from sphere_nmpc.estimation.odometry.newest_pose import NewestPose
from sphere_nmpc.estimation.odometry.placement import Placement
from sphere_nmpc.estimation.odometry.pose_estimate import PoseEstimate, pose_estimate
from sphere_nmpc.estimation.odometry.pose_history import PoseHistory
from sphere_nmpc.estimation.odometry.rest import RestDetector
from sphere_nmpc.estimation.odometry.rotor_speeds import RotorSpeeds
from sphere_nmpc.estimation.odometry.sensor_faults import SensorFaults
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers, OdometrySettings
from sphere_nmpc.model.error_state import POSE_ERROR
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, as_state
from sphere_nmpc.model.units import RobotUnits
from sphere_nmpc.reporting.conditions import Condition, Kind, worst_first

_GAP = 4.0
"""Times of a reading [-] after which readings are missing."""


class Odometry:
    """Estimator of the pose from an IMU in the shell and the rotors' encoders.

    Until the sphere has been at rest for `calibration_time` there is no estimate. Times are those
    of measurement [s; control time].

    Parameters
    ----------
    settings : Odometry.Settings, optional
        Start, and what is known of robot and fixes.
    imu : Odometry.Imu, optional
        Mounting and errors of the IMU.
    robot : RobotParameters, optional
        Robot as built; defaults to that of Table 1.
    """

    Settings, Imu = OdometrySettings, ImuSettings

    def __init__(
        self, settings: OdometrySettings | None = None, imu: ImuSettings | None = None,
        robot: RobotParameters | None = None,
    ) -> None:
        settings, imu = settings or OdometrySettings(), imu or ImuSettings()
        robot = robot or RobotParameters()
        self._settings = settings
        self._numbers = OdometryNumbers().of(RobotUnits.of(robot))
        self._filter = InertialFilter(imu, robot, self._numbers, settings.pivoting)
        self._imu, self._robot = imu, robot
        self.faults = SensorFaults(imu, self._numbers)
        """Faults of the sensors, and what has happened to the sphere."""
        self._placement = Placement(self._filter, settings, self._numbers, self.faults)
        self.fixes_used = self.fixes_left_out = 0
        """Numbers of fixes since the start."""
        self.calibration = ""
        """Biases that were found at rest, in one line; "" before."""
        given = as_state(settings.initial_state)
        self._given = Fix(-math.inf, given, self._placement.covariance(given, None))
        self._begin()

    def _begin(self) -> None:
        """Begin anew without readings."""
        self._belief: Belief | None = None
        self._stood: tuple[float, Belief]
        self._open = Samples([], [], [], [])
        self._history = PoseHistory(self._filter, self._settings.fix_memory, self._numbers)
        self._speeds = RotorSpeeds(self._numbers.silence, self._robot)
        self._rest = RestDetector(self._filter.imu, self._robot.lumped.input_gain, self._numbers)
        self._pending: list[Fix] = []
        self._fixes: list[Fix] = []
        self._newest = NewestPose(self._filter, self._given.pose)
        self._step = 0.0

    @property
    def is_calibrated(self) -> bool:
        """Whether the sphere has rested long enough once, so that there is an estimate."""
        return self._belief is not None

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The present conditions, the worst first; what the calibration waits for is first."""
        found = self.faults.conditions
        if self.is_calibrated or not self._open.times:
            return found
        needed = f"{self._settings.calibration_time:g} s"
        since = f"at rest for {self._rest.duration:.1f} s"
        text = f"given {self._rest.moves or since}, expected {needed} of rest"
        return worst_first((*found, Condition(Kind.CALIBRATING, text)))

    @property
    def delay(self) -> float:
        """Time by which readings of the IMU are later than their stamps [s]."""
        return 0.5 * self._step if self._imu.delay < 0.0 else self._imu.delay

    @property
    def estimate(self) -> PoseEstimate | None:
        """The pose at the newest reading; None before the calibration."""
        if self._belief is None:
            return None
        # Of an even distribution over the time between two readings.
        spread = self._step / math.sqrt(12.0) if self._imu.delay < 0.0 else 0.0
        return pose_estimate(
            self._filter, self._belief._replace(pose=self._newest.pose), self._open.times[-1],
            self._newest.rate, (self.delay, spread), self._numbers.interval,
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
        given = np.asarray(rate, float), np.asarray(force, float)
        newest = self._open.times[-1] if self._open.times else math.inf
        if time > newest + max(self._numbers.interval, _GAP * self._step):
            self._bridge(time)
            if self._belief is not None and time > self._open.times[-1] + self._numbers.silence:
                return self._cross_gap(time, *given)
        return self._take(time, *given, True)

    def observe_rotors(self, time: float, speeds: Vector, angles: Vector | None = None) -> bool:
        """Take speeds [rad/s] and, where known, angles [rad] of the rotors, shape (2,) each.

        Speeds that are not finite, or 0 while the angles change, follow from the angles. Return
        whether there is a new estimate: without an IMU that moves by the rotors alone.
        """
        is_known = bool(np.isfinite(speeds).all())
        if not math.isfinite(time) or not (is_known or angles is not None):
            raise InvalidInputError("rotor speeds", [time, *speeds], "finite numbers")
        stamp, taken = time, np.asarray(speeds, float)
        found = None if angles is None else self._speeds.by_angles(time, np.asarray(angles, float))
        if found is not None and (not is_known or self.faults.are_none(speeds, found[1])):
            stamp, taken = found
        elif not is_known:
            return False
        if self.faults.rotors(time, taken, angles):
            self._speeds.clear()
        if not self._speeds.append(stamp, taken):
            return False
        newest = self._open.times[-1] if self._open.times else math.nan
        if time > newest + self._numbers.silence and self.is_calibrated:
            self.faults.see(Kind.IMU_SILENT, time, f"given none for {time - newest:.2f} s")
            self._bridge(math.inf)
            return True
        if self._belief is None:
            # Without an IMU nothing else discards them.
            self._speeds.forget_before(time - self._numbers.silence - self._numbers.interval)
        self._close_if_due()
        return False

    def _bridge(self, until: float) -> None:
        """Move by the rotors since the newest reading, up to a time [s]."""
        held = self._open
        newest, rate, force = held.times[-1], held.rates[-1], held.forces[-1]
        for stamp in [stamp for stamp in self._speeds.times if newest < stamp < until]:
            self._take(stamp, rate, force, False)

    def _cross_gap(self, time: float, rate: Vector, force: Vector) -> bool:
        """Take the first reading after a time in which nothing is known of the motion."""
        gap = time - self._open.times[-1]
        self._close()
        if self._newest.was_still:
            # It has probably rested; a rest that contradicts the tilt shows otherwise.
            self._open = Samples([], [], [], [])
            return self._take(time, rate, force, True)
        self._take(time, rate, force, False)
        self._close()
        self._open.valid[0] = True
        self.faults.lost(time, f"given no reading for {gap:.2f} s in motion")
        return True

    def set_pose(self, time: float, pose: Vector, covariance: Vector | None) -> None:
        """Place the sphere, at the newest reading.

        `covariance`, shape (5, 5), is that of `PoseEstimate`, None where it is not known. Where
        the tilt has a variance of 0, as RViz sends it, or is contradicted by gravity, position
        and heading are taken alone.
        """
        pose = as_state(pose)
        given = Fix(time, pose, self._placement.covariance(pose, covariance))
        self.faults.placed()
        if self._belief is None:
            self._given = given
            return
        self._close()
        rested = self._rest.recent(self._numbers.rest) if self._rest.duration else None
        self._belief = self._placement.placed(self._belief, given, rested)
        self._history.clear()
        self._follow_readings()

    def correct(self, time: float, pose: Vector, covariance: Vector | None) -> Condition | None:
        """Take a pose that was measured elsewhere at `time` [s]; see `set_pose`.

        Return why it is not used, or None. One that is ahead of the readings waits for them.
        """
        pose = as_state(pose)
        if not math.isfinite(time):
            raise InvalidStateError("time of the fix", time, "a finite number [s]")
        if self._belief is None:
            return self._left_out("given a fix before the calibration of the IMU")
        memory, newest = self._settings.fix_memory, self._open.times[-1]
        if time > newest + memory:
            return self._left_out(
                f"given a stamp {time - newest:.3g} s ahead of the newest reading of the IMU, "
                "expected the clock of the IMU"
            )
        oldest = min(self._history.oldest, self._open.times[0])
        if time < max(oldest, newest - memory):
            return self._left_out(
                f"given a fix {newest - time:.3g} s old, expected at most "
                f"{min(newest - oldest, memory):.3g} s (fix_memory)"
            )
        self._fixes = [one for one in self._fixes if one.time > newest - 2.0 * memory]
        if any(one.time == time and np.array_equal(one.pose, pose) for one in self._fixes):
            return self._left_out("given the same fix again")
        # Readings are those of the time of their stamps less the delay.
        fix = Fix(time + self.delay, pose, self._placement.covariance(pose, covariance))
        self._fixes.append(Fix(time, pose, fix.covariance))
        if fix.time > self._open.times[0]:
            self._pending.append(fix)
            return None
        return self._use(fix)

    def check(self, time: float) -> None:
        """Notice sensors that are silent at control time `time` [s]."""
        newest = self._open.times[-1] if self._open.times else -math.inf
        if time > newest + self._numbers.silence:
            given = "given none" if newest < 0.0 else f"given none for {time - newest:.2f} s"
            self.faults.see(Kind.IMU_SILENT, time, given)
        if self._speeds.times and not self._speeds.reach(time - self._numbers.silence):
            self.faults.see(Kind.ENCODERS_SILENT, time, "slow motions and pushes cannot be seen")
        self.faults.forget_before(time - self._numbers.remembered)

    def forget(self) -> None:
        """Discard all readings, as after a jump of the clock; the pose stays."""
        if self._belief is not None:
            world = self._belief.covariance[POSE_ERROR, POSE_ERROR]
            self._given = Fix(-math.inf, self._newest.pose, world)
        self._begin()

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
        if self._belief is not None and len(samples.times) > 1:
            self._newest.move(self._belief, samples, len(samples.times) - 1, self._speeds.newest)
        self._close_if_due()
        return self.is_calibrated

    def _close_if_due(self) -> None:
        """End the open interval where it is long enough and the speeds of the rotors are there."""
        times, numbers = self._open.times, self._numbers
        due = times[0] + numbers.interval * (1.0 - 1e-6) if times else math.inf
        if not times or times[-1] < due:
            return
        end = bisect_left(times, due)
        step = (times[end] - times[0]) / end
        late = -0.5 * step if self._belief is None else self._belief.late
        is_known = self._speeds.cover(times[end], step, late)
        is_late = times[-1] > times[end] + numbers.silence
        if is_known or is_late or not self._speeds.reach(times[end] - numbers.silence):
            self._close(end)

    def _close(self, end: int = -1) -> None:
        """End the open interval at one of its readings; the others begin the next one."""
        whole = self._open
        end = len(whole.times) - 1 if end < 0 else end
        if end < 1:
            return
        before, after = whole.part(slice(0, end + 1)), whole.part(slice(end, None))
        self._step, self._open = before.step, after
        belief = self._belief
        samples = self._speeds.added_to(before, -self.delay if belief is None else belief.late)
        rests = self._rest.observe(samples)
        self._speeds.forget_before(samples.times[0] - 2.0 * self._numbers.interval)
        if belief is None:
            self._calibrate(samples)
            return
        if rests:
            belief, samples = self._with_rest(belief, samples)
        self._history.append(belief, samples)
        self._belief, findings = self._filter.advance(belief, samples)
        self._newest.was_still = samples.still
        self.faults.interval(samples, findings, self._belief, self.delay)
        if samples.still and self._rest.is_lasting():
            # Of the last while, as biases walk over a long rest.
            mean = self._rest.recent(self._numbers.contradicted)
            tilted = self._placement.tilted(self._belief, mean, -self.delay)
            if tilted is not None:
                self._belief = tilted
                self._history.clear()
        due = [fix for fix in self._pending if fix.time <= samples.times[-1]]
        self._pending = [fix for fix in self._pending if fix.time > samples.times[-1]]
        for fix in due:
            self._use(fix)
        self._follow_readings()

    def _follow_readings(self) -> None:
        """Move the pose by the readings since the last interval."""
        if self._belief is not None:
            self._newest.follow(self._belief, self._open, self._speeds.newest)

    def _with_rest(self, belief: Belief, samples: Samples) -> tuple[Belief, Samples]:
        """Return whether a shell whose readings do not change is still, in the samples.

        With the bias as known it may turn slowly. Where that goes on, but its tilt does not
        change, the bias is another one, which the belief that is returned has.
        """
        rest, largest = self._rest, self._numbers.improbable(3)
        means = samples._replace(still=True), rest.recent(self._numbers.rest)
        if all(self._filter.rest_square(belief, mean) < largest for mean in means):
            self._stood = samples.times[-1], belief
            return belief, means[0]
        if not rest.is_lasting(self._stood[0]):
            return belief, samples
        if rest.since < self._stood[0] + 3.0 * samples.duration:
            belief = self._stood[1]  # it has rested all the time
        found = self._filter.with_other_bias(belief, rest.recent(self._numbers.contradicted))
        return found, means[0]

    def _calibrate(self, samples: Samples) -> None:
        """Begin where the sphere has rested long enough, by the means over that rest."""
        needed = self._settings.calibration_time
        if needed > 0.0:
            if self._rest.duration < needed * (1.0 - 1e-6):
                return
            samples, densities, scatter = self._rest.rested()
            norm = float(np.linalg.norm(samples.forces[0]))
            if not self.faults.gravity(samples.times[-1], norm):
                return
            self._filter.raise_noises(*densities)
            noise = self._filter.imu.gyro_noise / math.sqrt(self._step)
            self._newest.scatter = max(scatter, noise)
        self._belief = self._placement.started(samples, self._given, -self.delay)
        bias, rested = self._belief.value(GYRO_BIAS), self._rest.duration
        left = math.sqrt(float(np.trace(self._belief.covariance[GYRO_BIAS, GYRO_BIAS])) / 3.0)
        shown = ", ".join(f"{math.degrees(one):.3f}" for one in bias)
        self.calibration = (
            f"gyro bias [{shown}] deg/s +- {math.degrees(left):.3f}, {rested:.1f} s at rest"
        )
        self._stood = samples.times[-1], self._belief
        self.faults.bias(samples.times[-1], bias)
        self._newest.was_still = samples.still
        self._follow_readings()

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
