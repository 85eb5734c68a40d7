# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the sensors in the shell, and what has happened to the sphere, as conditions."""

import math

import numpy as np

from sphere_nmpc.estimation.imu import ImuSettings, convention_of
from sphere_nmpc.estimation.odometry.inertial_filter import SATURATED
from sphere_nmpc.estimation.odometry.inertial_state import OFFSET, Belief, Findings, Samples
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.error_state import CONTRADICTING_DEVIATIONS, SIGNIFICANT_DEVIATIONS
from sphere_nmpc.model.state import Vector
from sphere_nmpc.reporting.conditions import Condition, Kind, worst_first

_REPEATED = 3
"""Equal readings in a row of a sensor that is stuck: noise changes some digit of six each time."""
_CONTRADICTIONS = 8
"""Intervals in which the shell turns otherwise than by the rotors: a push takes some."""
_TURNING = 1.0
"""Speed by the angles at which the rotors turn [rad/s]: an encoder that toggles shows less."""
LOST = frozenset((Kind.LIFTED, Kind.POSITION_UNKNOWN))
"""Kinds that last until a pose is given, as the position is not known."""
_LASTING = LOST | {Kind.TILT_REPLACED, Kind.NO_GRAVITY, Kind.LARGE_BIAS}
_LOST_BY = 0.1
"""Angle by which the shell has turned unnoticed at which it has been moved as well [rad]."""
_LATE = 8e-3
"""Reported offset of stamps [s]: more than half of the time between two readings at 100 Hz, by
which the delay of an IMU is not known; at full acceleration the rotors change by 3 rad/s in it."""


class SensorFaults:
    """Conditions of the odometry, each of which is reported for a while after it was last seen."""

    def __init__(self, imu: ImuSettings, numbers: OdometryNumbers) -> None:
        self._imu, self._numbers = imu, numbers
        self._seen: dict[Kind, tuple[float, str]] = {}
        self._last: Vector = np.zeros(6)
        self._equal = 0
        self._angles: tuple[float, Vector] | None = None
        self._contradictions, self._contradicted_at = 0, -math.inf
        self._may_be_pushed = self._is_moving = False
        self._late = 0
        self.are_encoders_stuck = False
        """Whether the encoders have shown no turning although the rotors turn."""

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The present ones, the worst first."""
        return worst_first(Condition(kind, text) for kind, (_, text) in self._seen.items())

    def see(self, kind: Kind, time: float, text: str) -> None:
        """Note a condition at control time `time` [s]."""
        self._seen[kind] = time, text

    @property
    def is_lost(self) -> bool:
        """Whether the position is not known until a pose is given."""
        return not LOST.isdisjoint(self._seen)

    def forget_before(self, time: float) -> None:
        """Forget what was last seen before a time [s], but what lasts until a pose is given."""
        self._seen = {
            kind: seen for kind, seen in self._seen.items() if seen[0] >= time or kind in _LASTING
        }

    def placed(self) -> None:
        """Note that the position is known again."""
        for kind in LOST | {Kind.TILT_REPLACED}:
            self._seen.pop(kind, None)

    def lost(self, time: float, given: str) -> None:
        """Note that the position is not known, and what has been given instead."""
        self.see(
            Kind.POSITION_UNKNOWN, time,
            f"{given}; the position is not known until pose_fix or initialpose gives it",
        )

    def gravity(self, time: float, norm: float) -> bool:
        """Return whether the norm of a specific force at rest [m/s^2] is that of gravity."""
        imu, convention = self._imu, convention_of(norm)
        spread = math.hypot(imu.accelerometer_bias, GRAVITY * imu.accelerometer_scale)
        if abs(norm - GRAVITY) > max(CONTRADICTING_DEVIATIONS * spread, 0.1 * GRAVITY):
            self.see(
                Kind.NO_GRAVITY, time,
                f"given a specific force of {norm:.3g} m/s^2 at rest, expected {GRAVITY:.2f} "
                f"opposite to gravity{convention and f': {convention}'}",
            )
            return False
        self._seen.pop(Kind.NO_GRAVITY, None)
        return True

    def bias(self, time: float, bias: Vector) -> None:
        """Take a bias of the gyro [rad/s], shape (3,)."""
        largest = float(np.max(np.abs(bias)))
        if largest > CONTRADICTING_DEVIATIONS * self._imu.gyro_bias:
            self.see(
                Kind.LARGE_BIAS, time,
                f"given {largest:.2g} rad/s, expected some imu.gyro_bias = "
                f"{self._imu.gyro_bias:.2g} rad/s; or are readings in deg/s?",
            )

    def tilted(self, time: float, angle: float) -> None:
        """Note that gravity shows a vertical that is another one by an angle [rad]."""
        shown = f"given a vertical that is {math.degrees(angle):.1f} deg from that estimated"
        self.see(Kind.TILT_REPLACED, time, f"{shown}, at rest; that of the accelerometer is taken")
        if angle > _LOST_BY:
            self.lost(time, shown)

    def reading(self, time: float, rate: Vector, force: Vector) -> bool:
        """Return whether a reading of the IMU can be believed."""
        reading = np.concatenate((rate, force))
        self._equal = self._equal + 1 if np.array_equal(reading, self._last) else 0
        self._last = reading
        self._seen.pop(Kind.IMU_SILENT, None)
        if float(np.max(np.abs(rate))) >= SATURATED * self._imu.gyro_range:
            self.see(
                Kind.GYRO_SATURATED, time,
                f"given {np.max(np.abs(rate)):.3g} rad/s, expected less than gyro_range = "
                f"{self._imu.gyro_range:.3g} rad/s; the rotors show how it turns meanwhile",
            )
            return False
        # At rest readings without noise repeat.
        return self._equal < _REPEATED or not self._is_moving

    def are_none(self, speeds: Vector, by_angles: Vector) -> bool:
        """Return whether speeds are 0 as a driver sends them that does not measure them."""
        return not np.any(speeds) and float(np.max(np.abs(by_angles))) > _TURNING

    def rotors(self, time: float, speeds: Vector, angles: Vector | None) -> bool:
        """Take speeds [rad/s] and angles [rad]; return whether those before cannot be believed."""
        self._seen.pop(Kind.ENCODERS_SILENT, None)
        if angles is None:
            return False
        was_stuck = self.are_encoders_stuck
        is_turning = self._angles is None or not np.array_equal(angles, self._angles[1])
        if self._angles is None or is_turning:
            self._angles = time, np.array(angles)
        if is_turning or time > self._contradicted_at + self._numbers.remembered:
            self._contradictions = 0
        turned = float(np.max(np.abs(speeds))) * (time - self._angles[0])
        is_stuck = time - self._angles[0] > self._numbers.silence and turned > 1.0
        self.are_encoders_stuck = is_stuck or self._contradictions >= _CONTRADICTIONS
        if self.are_encoders_stuck:
            self.see(
                Kind.ENCODERS_STUCK, time,
                f"given angles that stand still at {np.max(np.abs(speeds)):.3g} rad/s while the "
                "shell turns otherwise, expected those of the rotors; they are left out",
            )
        return was_stuck or self.are_encoders_stuck

    def interval(
        self, samples: Samples, findings: Findings, belief: Belief, delay: float
    ) -> None:
        """Take what an interval has shown; `delay` is the expected one of the IMU [s]."""
        time, numbers = samples.times[-1], self._numbers
        self._is_moving = samples.speeds is not None and not samples.still
        if self._equal >= _REPEATED and not samples.usable:
            self.see(
                Kind.IMU_STUCK, time,
                f"given the same reading {self._equal + 1} times while the rotors turn, expected "
                "noise; the rotors show how it turns meanwhile",
            )
        jump = findings.jump
        largest = numbers.improbable(3)
        if findings.force > largest:
            if numbers.is_lifted(belief.height, belief.slipping):
                self.see(
                    Kind.LIFTED, time,
                    f"given a vertical way of {belief.height:+.2f} m; the position is not known "
                    "until pose_fix or initialpose gives it",
                )
            else:
                self.see(
                    Kind.SLIPPED, time,
                    f"given a change of velocity by {math.hypot(jump[0], jump[1]):.2g} m/s that "
                    "rolling does not explain; the position is less certain",
                )
        elif findings.rate > largest:
            self._contradictions, self._contradicted_at = self._contradictions + 1, time
        offset, spread = belief.late + delay, belief.deviation(slice(OFFSET, OFFSET + 1))
        is_late = abs(offset) > max(_LATE, SIGNIFICANT_DEVIATIONS * spread)
        # Speeds that come late look like a push until they have come.
        if self._may_be_pushed and not is_late:
            self.see(
                Kind.PUSHED, time,
                "given an angular velocity that the rotors do not explain, with a momentum",
            )
        self._may_be_pushed = findings.rate > largest
        is_disturbed = Kind.PUSHED in self._seen or Kind.SLIPPED in self._seen
        self._late = self._late + 1 if is_late and not is_disturbed else 0
        if self._late >= _CONTRADICTIONS:
            self.see(
                Kind.ENCODERS_LATE, time,
                f"given stamps of the rotor speeds {1e3 * offset:.1f} ms behind those of the IMU, "
                "expected the same clock; they are shifted by that",
            )
