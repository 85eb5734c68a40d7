# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimate of a goal that is given again and again: where it is, and how fast it moves.

What another node publishes at 10 Hz is never quite the same, be it noise or motion. A straight
line is fitted to the newest goals. Where its slope is not significant the goal stands at their
mean, and it is changed only by what is more than their noise.
"""

from collections import deque
from dataclasses import replace

import numpy as np

from sphere_nmpc.model.error_state import (
    CONTRADICTING_DEVIATIONS,
    SIGNIFICANT_DEVIATIONS,
    apply_error,
    error_between,
)
from sphere_nmpc.model.goal import STANDING, Goal
from sphere_nmpc.model.state import Vector, angle_error, position_error

_MAX_GAP = 0.6
"""Time between two goals [s] above which they have nothing to do with each other, and after which
the last one counts as standing."""
_MAX_STEP, _MAX_TURN = 0.15, 0.5
"""Difference from what was expected [m, rad] up to which a goal is the one before, moved."""
_WINDOW, _MAX_WINDOW_TURN = 1.5, 1.5
"""Time [s] of which goals are kept, and turn [rad] up to which they are on a line."""
_MIN_SPACING = 0.04
"""Least time between goals that are kept [s], but for the newest one."""
_MIN_GOALS_FOR_RATE = 3
"""Number of goals from which on a rate and their noise are estimated."""
_LEAST_NOISE = np.array([2e-4, 1e-3])
"""Least standard deviation of goals [m, rad]: that of rounded numbers."""
_PARTS = (slice(0, 2), slice(2, 5))
"""Position and orientation in an error of a pose."""


def current(goal: Goal, time: float) -> Goal:
    """Return a goal as it is at a control time [s]: one that is no longer given stands."""
    if goal.rate.any() and time - goal.since > _MAX_GAP:
        return replace(goal, rate=STANDING)
    return goal


class GoalMotion:
    """Estimator of one goal from the messages that give it."""

    def __init__(self) -> None:
        self._given: deque[tuple[float, Vector]] = deque()
        self._goal: Goal | None = None
        self._noise = _LEAST_NOISE

    def update(self, time: float, given: Goal) -> tuple[Goal, bool]:
        """Return the goal to track from now on, and whether it is another than the last.

        Parameters
        ----------
        time : float
            Control time of the goal [s].
        given : Goal
            The goal as given then.
        """
        goal = self._goal
        if goal is None or not self._continues(goal, time, given):
            self._given = deque([(time, given.pose)])
            self._noise = _LEAST_NOISE
            self._goal = replace(given, since=time)
            return self._goal, True
        if len(self._given) > 1 and time < self._given[-2][0] + _MIN_SPACING:
            self._given.pop()
        self._given.append((time, given.pose))
        while self._is_off(*self._given[0]):
            self._given.popleft()
        self._goal = self._estimate(goal)
        return self._goal, False

    def _continues(self, goal: Goal, time: float, given: Goal) -> bool:
        newest = self._given[-1][0]
        if given.orientation is not goal.orientation or not newest < time <= newest + _MAX_GAP:
            return False
        expected = goal.orientation.nearest(goal.at(time), given.pose)
        near = position_error(expected, given.pose) < _MAX_STEP
        return near and angle_error(expected, given.pose) < _MAX_TURN

    def _is_off(self, time: float, pose: Vector) -> bool:
        """Return whether a goal is too far from the newest one to be on a line with it."""
        newest = self._given[-1]
        return time < newest[0] - _WINDOW or bool(angle_error(pose, newest[1]) > _MAX_WINDOW_TURN)

    def _estimate(self, goal: Goal) -> Goal:
        """Return the goal by a line through the newest poses."""
        times = np.array([time for time, _ in self._given])
        newest = self._given[-1][1]
        errors = np.array([error_between(newest, pose) for _, pose in self._given])
        ages, count = times - times[-1], times.size
        if count < _MIN_GOALS_FOR_RATE:
            return replace(goal, pose=newest, rate=STANDING, since=float(times[-1]))
        mean, centred = np.mean(errors, axis=0), ages - np.mean(ages)
        spread = float(centred @ centred)
        slope = centred @ errors / spread
        left = errors - mean - np.outer(centred, slope)
        if self._is_changed(left):
            # The one before may be where the goal has stopped or turned.
            while len(self._given) > _MIN_GOALS_FOR_RATE - 1:
                self._given.popleft()
            return self._estimate(goal)
        value: Vector = mean.copy()
        rate: Vector = np.zeros(5)
        noise = np.array([
            np.sqrt(np.sum(left[:, part] ** 2) / ((count - 2.0) * (part.stop - part.start)))
            for part in _PARTS
        ])
        self._noise = np.maximum(noise, _LEAST_NOISE)
        for part, sigma in zip(_PARTS, self._noise, strict=True):
            if np.linalg.norm(slope[part]) > SIGNIFICANT_DEVIATIONS * sigma / np.sqrt(spread):
                rate[part] = slope[part]
                value[part] = mean[part] - np.mean(ages) * slope[part]
        pose = apply_error(newest, value)
        if not rate.any() and not goal.rate.any():
            moved = position_error(pose, goal.pose), angle_error(pose, goal.pose)
            if np.all(np.array(moved) < SIGNIFICANT_DEVIATIONS * self._noise / np.sqrt(count)):
                return replace(goal, since=float(times[-1]))
        rate = rate if rate.any() else STANDING
        return replace(goal, pose=pose, rate=rate, since=float(times[-1]))

    def _is_changed(self, left: Vector) -> bool:
        """Return whether the newest goal is off the line of those before by more than noise."""
        if len(left) <= _MIN_GOALS_FOR_RATE:
            return False
        newest = [float(np.linalg.norm(left[-1, part])) for part in _PARTS]
        return bool(np.any(np.array(newest) > CONTRADICTING_DEVIATIONS * self._noise))
