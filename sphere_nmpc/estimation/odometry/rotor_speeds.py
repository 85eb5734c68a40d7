# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Measured speeds of the rotors, at the instants of the readings of an IMU."""

import math
from bisect import bisect_left, bisect_right

import numpy as np

from sphere_nmpc.estimation.odometry.inertial_state import Samples
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector

_FASTER = 1.5
"""Speed over the largest one at which an angle has begun anew [-]."""


class RotorSpeeds:
    """Buffer of measured speeds, in the order of their stamps.

    Parameters
    ----------
    longest_gap : float
        Time without speeds across which they are not interpolated [s].
    robot : RobotParameters
        Robot, whose rotors have a largest speed and acceleration.
    """

    def __init__(self, longest_gap: float, robot: RobotParameters) -> None:
        self._longest_gap, self._acceleration = longest_gap, robot.max_rotor_acceleration
        self._fastest = _FASTER * robot.max_rotor_speed
        self._angles: tuple[float, Vector] | None = None
        self.times: list[float] = []
        """Stamps [s]."""
        self._speeds: list[Vector] = []

    @property
    def newest(self) -> Vector | None:
        """The newest speeds [rad/s], shape (2,); None without any."""
        return self._speeds[-1] if self._speeds else None

    def by_angles(self, time: float, angles: Vector) -> tuple[float, Vector] | None:
        """Return the mean speeds [rad/s] since the angles [rad] before, and the middle time [s].

        None where they are not known. Angles may begin anew after a turn.
        """
        before, self._angles = self._angles, (time, angles)
        if before is None or not 0.0 < time - before[0] < self._longest_gap:
            return None
        step, turned = time - before[0], angles - before[1]
        if np.max(np.abs(turned)) > self._fastest * step:
            turned = (turned + math.pi) % (2.0 * math.pi) - math.pi
        return 0.5 * (time + before[0]), turned / step

    def append(self, time: float, speeds: Vector) -> bool:
        """Take speeds [rad/s] measured at `time` [s]; False where they are not newer."""
        if self.times and time <= self.times[-1]:
            return False
        self.times.append(time)
        self._speeds.append(speeds)
        return True

    def clear(self) -> None:
        """Discard all speeds."""
        self.times.clear()
        self._speeds.clear()

    def forget_before(self, time: float) -> None:
        """Discard speeds that are not needed from a time [s] on."""
        number = bisect_right(self.times, time) - 1
        if number > 0:
            del self.times[:number], self._speeds[:number]

    def reach(self, time: float) -> bool:
        """Return whether there are speeds up to a time [s]."""
        return bool(self.times) and self.times[-1] >= time

    def cover(self, end: float, step: float, late: float) -> bool:
        """Return whether there are speeds for an interval that ends at a time [s].

        They are needed up to a reading further, as the acceleration is that of the speeds before
        and after; `step` is the time between two readings [s], by a tenth of which stamps vary.
        """
        return self.reach(end + late + 0.9 * step)

    def added_to(self, samples: Samples, late: float) -> Samples:
        """Return an interval with the speeds, whose stamps are `late` [s], where they are known.

        Where they are not, their slope may have changed by all that it can.
        """
        times, step = samples.times, samples.step
        wanted = np.array([times[0] - step, *times, times[-1] + step]) + late
        first = max(0, bisect_right(self.times, times[0] + late) - 1)
        stamps = self.times[first : bisect_left(self.times, wanted[-1]) + 1]
        is_known = (
            self.cover(times[-1], step, late) and stamps[0] <= times[0] + late
            and max(np.diff(stamps), default=0.0) < self._longest_gap
        )
        if not is_known:
            return samples._replace(bend=step * self._acceleration)
        found = np.column_stack([
            np.interp(wanted, self.times, column) for column in np.transpose(self._speeds)
        ])
        bend = float(np.linalg.norm(np.diff(found, 2, axis=0)))
        return samples._replace(speeds=found[1:-1], bend=bend)
