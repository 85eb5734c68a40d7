# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Transition: two measured poses and the rotor speeds sent, or attained, in between."""

from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.model.state import Vector

_MANY = 48
"""Number of ends of pieces above which consecutive pieces on a straight line are joined ..."""
_STRAIGHT = 0.05
"""... if no end between them is further than this from the line [rad/s]."""
_SAME = 1e-9
"""Time [s] and speed [rad/s] below which two are the same."""


@dataclass(frozen=True, eq=False)
class Transition:
    """Measured states before and after a motion, and the rotor speeds that caused it.

    Attributes
    ----------
    start, end : ndarray, shape (6,)
        Measured states before and after.
    durations : ndarray, shape (K,)
        Lengths of the straight pieces of the rotor speeds [s].
    inputs : ndarray, shape (K + 1, 2)
        Rotor speeds at their ends [rad/s].
    lead : float
        Time from the start of the pieces to the first state [s]; without it the lag is not
        estimated.
    """

    start: Vector
    end: Vector
    durations: Vector
    inputs: Vector
    lead: float = 0.0

    @property
    def duration(self) -> float:
        """Time between the states [s]."""
        return float(np.sum(self.durations)) - self.lead

    @property
    def steepest(self) -> float:
        """Largest acceleration of the speeds [rad/s^2]."""
        slopes = np.diff(self.inputs, axis=0) / self.durations[:, None]
        return float(np.max(np.abs(slopes), initial=0.0))

    def straightened(self) -> "Transition":
        """Return the transition with fewer pieces, if it has many as at a high control rate."""
        if self.inputs.shape[0] <= _MANY:
            return self
        times = np.concatenate(([0.0], np.cumsum(self.durations)))
        kept = _corners(times, self.inputs)
        return replace(self, durations=np.diff(times[kept]), inputs=self.inputs[kept])

    def driven(self, acceleration: float, lead: float) -> "Transition":
        """Return the transition with the speeds that drives of this limit [rad/s^2] attain.

        `lead` is the longest time [s] before the first state that is kept; what went before only
        decides how far the rotors had fallen behind.
        """
        durations, inputs = self.durations, self.inputs
        if self.steepest > acceleration:
            durations, inputs = driven_speeds(durations, inputs, acceleration)
        driven = replace(self, durations=durations, inputs=inputs)
        if self.lead <= lead:
            return driven
        times = np.concatenate(([0.0], np.cumsum(durations)))
        begin = self.lead - lead
        kept = times > begin + _SAME
        first = [np.interp(begin, times, column) for column in inputs.T]
        return Transition(
            self.start, self.end, np.diff(np.concatenate(([begin], times[kept]))),
            np.vstack((first, inputs[kept])), lead,
        )

    def window(self, lag: float, until: float = np.inf) -> tuple[Vector, Vector]:
        """Return durations (K,) and speeds (K + 1, 2) that moved the sphere at this lag [s].

        `until` is the time [s] after the first state at which they end; by default the last.
        """
        given = np.concatenate(([0.0], np.cumsum(self.durations)))
        begin = self.lead - min(lag, self.lead)
        end = begin + min(float(given[-1]) - self.lead, until)
        inside = (given > begin + _SAME) & (given < end - _SAME)
        times = np.concatenate(([begin], given[inside], [end]))
        speeds = [np.interp(times, given, column) for column in self.inputs.T]
        return np.diff(times), np.column_stack(speeds)


def _corners(times: Vector, speeds: Vector) -> list[int]:
    """Return the indices of the ends whose connecting line stays near all others."""
    kept, last = [0], 0
    for i in range(2, times.size):
        share = (times[last + 1 : i] - times[last]) / (times[i] - times[last])
        line = speeds[last] + share[:, None] * (speeds[i] - speeds[last])
        if np.abs(speeds[last + 1 : i] - line).max() > _STRAIGHT:
            last = i - 1
            kept.append(last)
    return [*kept, times.size - 1]


def driven_speeds(
    durations: Vector, inputs: Vector, acceleration: float
) -> tuple[Vector, Vector]:
    """Return the pieces of rotors that follow straight pieces at a limited acceleration.

    A rotor that has fallen behind turns at the limit until it has caught up. At the start it has
    the speed that was sent.

    Both are lengths of pieces [s], shape (K,), and the speeds at their ends [rad/s], shape
    (K + 1, 2).
    """
    given = np.concatenate(([0.0], np.cumsum(durations)))
    paths = [_followed(given, column, acceleration) for column in inputs.T]
    times = np.unique(np.concatenate([given, *(path[0] for path in paths)]))
    times = times[np.concatenate(([True], np.diff(times) > _SAME))]
    speeds = [np.interp(times, *path) for path in paths]
    return np.diff(times), np.column_stack(speeds)


def _followed(times: Vector, sent: Vector, limit: float) -> tuple[list[float], list[float]]:
    """Return times [s] and speeds [rad/s] of the corners of one rotor's motion."""
    now, speed = float(times[0]), float(sent[0])
    corners, speeds = [now], [speed]
    ends, wants = times.tolist(), sent.tolist()
    for begin, end, before, wanted in zip(ends, ends[1:], wants, wants[1:], strict=False):
        if not end - begin > _SAME:
            continue
        slope = (wanted - before) / (end - begin)
        behind = wanted - slope * (end - now) - speed
        while end - now > _SAME:
            if abs(behind) < _SAME:
                rate, lasts = min(max(slope, -limit), limit), end - now
            else:
                rate = limit if behind > 0.0 else -limit
                closing = (rate - slope) * (1.0 if behind > 0.0 else -1.0)
                caught = abs(behind) / closing if closing > 0.0 else np.inf
                lasts = min(caught, end - now)
            now, speed = now + lasts, speed + rate * lasts
            behind += (slope - rate) * lasts
            corners.append(now)
            speeds.append(speed)
    return corners, speeds
