# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Detector of rest, by what does not change: the readings of the IMU and the rotors' speeds.

No bias or noise has to be known: the means of readings over short intervals are compared with
their own scatter, so that an idling engine or a noisy encoder does not count as motion.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry.inertial_state import Samples
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.state import Vector

_SIGNIFICANT = 8.0
"""Standard deviations [-] by which the means of two halves may differ: vibrations of an engine
differ less from one interval to the next than normal ones, and a day has 2 million intervals."""
_NORMAL = 0.954
"""Median difference of two normal numbers over their standard deviation [-]."""
_MOST_SCATTER = np.array([0.1] * 3 + [0.15 * GRAVITY] * 3)
"""Scatter of means over an interval at rest [rad/s, m/s^2]: more is motion."""
_MOST_BIAS = 0.15
"""Largest angular velocity that may be a bias of the gyro [rad/s]."""
_FEWEST = 6
"""Intervals whose scatter is known."""
_CHANNELS = ("gyro", "accelerometer", "rotors")
_UNITS = ("rad/s", "m/s^2", "rad/s")


class _Block(NamedTuple):
    """Means over an interval."""

    start: float
    end: float
    means: Vector
    """Rate [rad/s], force [m/s^2], speeds of the rotors [rad/s], 0 where not known, (8,)."""
    scatter: float
    """Variance of the rate within the interval [rad^2/s^2]."""


class RestDetector:
    """Test of whether the shell is at rest.

    Parameters
    ----------
    imu : ImuSettings
        Noises, below which a scatter is not taken to be.
    gain : float
        Angular velocity of the shell over the speed of a rotor, c1 [-].
    numbers : OdometryNumbers
        Times, and how slow the rotors have to be.
    """

    def __init__(self, imu: ImuSettings, gain: float, numbers: OdometryNumbers) -> None:
        self._numbers, self._slowest = numbers, numbers.still / gain
        self._densities = np.array([imu.gyro_noise] * 3 + [imu.accelerometer_noise] * 3)
        self._blocks: deque[_Block] = deque()
        self._sum: Vector = np.zeros(8)
        self.since = math.nan
        """Start of the rest [s]; nan where the shell does not rest."""
        self.moves = ""
        """What shows that it does not, in a few words."""

    @property
    def duration(self) -> float:
        """Time at rest [s]; 0 in motion."""
        return 0.0 if math.isnan(self.since) else self._blocks[-1].end - self.since

    def rested(self) -> tuple[Samples, Vector, float]:
        """Return the mean of the readings of the present rest, as an interval of its duration.

        Also the noise densities of gyro [rad/s/sqrt(Hz)] and accelerometer [m/s^2/sqrt(Hz)], (2,),
        and the standard deviation of a rate at an instant, about an axis [rad/s].
        """
        rows = np.array([block.means[:6] for block in self._blocks])
        step = self._blocks[-1].end - self._blocks[-1].start
        variances = step * rows.var(axis=0, ddof=1)
        densities = np.sqrt((variances[:3].mean(), variances[3:].mean()))
        scatter = math.sqrt(float(np.mean([block.scatter for block in self._blocks])))
        samples = self._at_rest(self.since, self._sum[:6] / self.duration)
        return samples, densities, scatter

    def recent(self, duration: float) -> Samples:
        """Return the mean of the readings of the last `duration` [s], or as far as they go."""
        since = self._blocks[-1].end - duration
        blocks = [block for block in self._blocks if block.end > since]
        return self._at_rest(blocks[0].start, np.mean([one.means for one in blocks], axis=0))

    def _at_rest(self, since: float, mean: Vector) -> Samples:
        return Samples(
            [since, self._blocks[-1].end], [mean[:3]] * 2, [mean[3:6]] * 2, [True] * 2, still=True
        )

    def observe(self, samples: Samples) -> bool:
        """Take the next interval; return whether the shell rests."""
        if not samples.usable:
            return self._moving("readings that cannot be believed")
        duration, weights = samples.duration, samples.weights
        readings = np.hstack((np.array(samples.rates), np.array(samples.forces)))
        mean = weights @ readings / duration
        speeds = np.zeros(2) if samples.speeds is None else weights @ samples.speeds / duration
        block = _Block(
            samples.times[0], samples.times[-1], np.concatenate((mean, speeds)),
            float(np.mean((readings - mean)[:, :3] ** 2)),
        )
        if self._blocks and samples.times[0] > self._blocks[-1].end + duration:
            self._moving("")
        self._blocks.append(block)
        numbers, end = self._numbers, block.end
        while end - self._blocks[0].start > numbers.contradicted + 0.5 * duration:
            self._blocks.popleft()
        recent = [one for one in self._blocks if one.start > end - numbers.rest - 0.5 * duration]
        if end - self._blocks[0].start < numbers.rest - duration or len(recent) < _FEWEST:
            return False
        moves = self._motion(np.array([one.means for one in recent]), duration)
        if moves:
            return self._moving(moves)
        if math.isnan(self.since):
            self.since, self._sum = recent[0].start, np.zeros(8)
            while self._blocks[0] is not recent[0]:
                self._blocks.popleft()
            for one in recent:
                self._sum += (one.end - one.start) * one.means
        else:
            self._sum += duration * block.means
        self.moves = ""
        return True

    def is_lasting(self, since: float = -math.inf) -> bool:
        """Return whether the shell has rested so long that its readings outweigh bias and tilt.

        That is where these have been contradicted since a time [s].
        """
        if self._blocks[-1].end - max(self.since, since) < self._numbers.contradicted:
            return False
        rows = np.array([block.means for block in self._blocks])
        return not self._motion(rows, self._blocks[-1].end - self._blocks[-1].start)

    def _moving(self, why: str) -> bool:
        self._blocks.clear()
        self.since, self.moves = math.nan, why
        return False

    def _motion(self, rows: Vector, duration: float) -> str:
        """Return what changes in rows of means, each over `duration` [s]; "" for nothing."""
        first, second = rows[: len(rows) // 2], rows[len(rows) // 2 :]
        # By the median difference of neighbours, which neither a slow change nor some intervals
        # of motion enlarge.
        scatter = np.median(np.abs(np.diff(rows, axis=0)), axis=0) / _NORMAL
        if np.any(scatter[:6] > _MOST_SCATTER):
            return "readings that scatter as in motion"
        least = np.append(self._densities / math.sqrt(duration), [0.5 * self._slowest] * 2)
        scatter = np.maximum(scatter, least)
        change = np.abs(second.mean(axis=0) - first.mean(axis=0))
        away = np.max(np.abs(rows - np.median(rows, axis=0)), axis=0)
        over = np.maximum(change / (2.0 / math.sqrt(len(rows))), away) / scatter
        worst = int(np.argmax(over))
        if over[worst] > _SIGNIFICANT:
            amount = max(change[worst], away[worst])
            group = worst // 3
            return f"a change of the {_CHANNELS[group]} by {amount:.2g} {_UNITS[group]}"
        mean = np.abs(rows.mean(axis=0))
        turning = mean[6:] - _SIGNIFICANT * scatter[6:] / math.sqrt(len(rows))
        if np.any(turning > self._slowest):
            return f"rotors that turn with {np.max(mean[6:]):.2g} rad/s"
        if np.max(mean[:3]) > _MOST_BIAS:
            return (
                f"an angular velocity of {np.max(mean[:3]):.2g} rad/s, expected at most "
                f"{_MOST_BIAS:g} rad/s of a bias"
            )
        return ""
