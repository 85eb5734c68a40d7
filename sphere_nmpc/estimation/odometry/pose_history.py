# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""History of an odometry, in which a pose is used at the instant of its measurement."""

import math
from bisect import bisect_left
from collections import deque
from typing import NamedTuple

import numpy as np

from sphere_nmpc.estimation.odometry.given_pose import (
    MOST_VARIANCE,
    Fix,
    has_tilt,
    with_vertical,
)
from sphere_nmpc.estimation.odometry.inertial_filter import InertialFilter
from sphere_nmpc.estimation.odometry.inertial_state import Belief, Samples, replaced
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers
from sphere_nmpc.estimation.settings import TABLE_1_NUMBERS
from sphere_nmpc.model import rotation
from sphere_nmpc.model.error_state import POSE_ERROR
from sphere_nmpc.model.state import QUATERNION, Vector


class _Interval(NamedTuple):
    """Readings of an interval, the belief at its start, and fixes at its end."""

    start: Belief
    samples: Samples
    fixes: tuple[Fix, ...] = ()


class PoseHistory:
    """Intervals that have ended, up to `memory` [s] old.

    Parameters
    ----------
    inertial_filter : InertialFilter
        Filter by which intervals are repeated.
    memory : float
        Age up to which fixes are used [s].
    numbers : OdometryNumbers
        When a fix is left out.
    """

    def __init__(
        self, inertial_filter: InertialFilter, memory: float, numbers: OdometryNumbers
    ) -> None:
        self._filter, self._memory, self._numbers = inertial_filter, memory, numbers
        self._intervals: deque[_Interval] = deque()
        self._refused = 0

    @property
    def oldest(self) -> float:
        """Start of the history [s]; inf without any."""
        return self._intervals[0].samples.times[0] if self._intervals else math.inf

    def append(self, start: Belief, samples: Samples) -> None:
        """Take an interval that has ended, and forget what is too old."""
        self._intervals.append(_Interval(start, samples))
        oldest = samples.times[-1] - self._memory
        while len(self._intervals) > 1 and self._intervals[1].samples.times[0] < oldest:
            self._intervals.popleft()

    def clear(self) -> None:
        """Forget all, as the pose is another one now."""
        self._intervals.clear()
        self._refused = 0

    def use(self, fix: Fix) -> Belief | str:
        """Return the belief at the end with a fix, or in one line why it is left out."""
        found = self._split(fix.time)
        interval = self._intervals[found]
        belief, samples = self._end_of(interval), interval.samples
        rate: Vector = np.zeros((1, 3))
        if not samples.still:
            sensor = self._filter.sensor(belief)
            rate = sensor.rates(np.array(samples.rates[-1:]), np.array(samples.forces[-1:]))
        # The nearest reading is up to half a sample from it.
        pose = self._filter.moved(
            fix.pose, rate[[0, 0]], samples.times[-1] - fix.time, self._filter.rolled(belief)
        )
        fix = fix._replace(pose=pose)
        if not has_tilt(fix.covariance):
            vertical = rotation.vertical(belief.pose[QUATERNION])
            fix = with_vertical(fix, vertical, MOST_VARIANCE[1] * np.eye(2))
        fixed, square = self._filter.with_pose(belief, fix.pose, fix.covariance, math.inf)
        is_off = square > self._numbers.improbable(5)
        # Several in a row agree with each other rather than with the filter.
        most = TABLE_1_NUMBERS.most_outliers
        if is_off and self._refused < most:
            self._refused += 1
            return f"{_differing(fix, belief)}; after {most} in a row the next one is believed"
        self._refused = 0
        more = fix._replace(replaces=is_off)
        self._intervals[found] = interval._replace(fixes=(*interval.fixes, more))
        belief = replaced(belief, fix.pose, fix.covariance) if is_off else fixed
        for k in range(found + 1, len(self._intervals)):
            self._intervals[k] = self._intervals[k]._replace(start=belief)
            belief = self._end_of(self._intervals[k])
        return belief

    def _end_of(self, interval: _Interval) -> Belief:
        """Return the belief at the end of an interval, with its fixes."""
        belief, _ = self._filter.advance(interval.start, interval.samples)
        for fix in interval.fixes:
            if fix.replaces:
                belief = replaced(belief, fix.pose, fix.covariance)
            else:
                belief, _ = self._filter.with_pose(belief, fix.pose, fix.covariance, math.inf)
        return belief

    def _split(self, time: float) -> int:
        """Return the interval that ends at the reading nearest to a time; one is split for it."""
        ends = [interval.samples.times[-1] for interval in self._intervals]
        k = min(bisect_left(ends, time), len(ends) - 1)
        start, samples, fixes = self._intervals[k]
        times = samples.times
        nearest = min(range(len(times)), key=lambda j: abs(times[j] - time))
        if nearest == len(times) - 1 or (nearest == 0 and k == 0):
            return k
        if nearest == 0:
            return k - 1
        first, second = samples.part(slice(0, nearest + 1)), samples.part(slice(nearest, None))
        belief, _ = self._filter.advance(start, first)
        self._intervals[k] = _Interval(start, first)
        self._intervals.insert(k + 1, _Interval(belief, second, fixes))
        return k


def _differing(fix: Fix, belief: Belief) -> str:
    """Return in what a fix differs the most from what is estimated, and what was expected."""
    spread = fix.covariance + belief.covariance[POSE_ERROR, POSE_ERROR]
    turn = rotation.product(fix.pose[QUATERNION], rotation.conjugate(belief.pose[QUATERNION]))
    away = math.dist(fix.pose[:2], belief.pose[:2])
    turned = float(np.linalg.norm(rotation.logarithm(turn)))
    place, angle = (math.sqrt(float(np.trace(part))) for part in (spread[:2, :2], spread[2:, 2:]))
    if away / place >= turned / angle:
        return f"given a position {away:.3g} m from that estimated, expected some {place:.2g} m"
    return (
        f"given an orientation {math.degrees(turned):.3g} deg from that estimated, expected some "
        f"{math.degrees(angle):.2g} deg"
    )
