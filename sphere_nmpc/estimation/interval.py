# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Interval between two knots of the estimator: measured poses, and the rotor speeds sent."""

from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.model.state import INPUT_SIZE, Vector

_SAME = 1e-9
"""Time [s] and speed [rad/s] below which two are the same."""


@dataclass(frozen=True, eq=False)
class Interval:
    """Poses measured in an interval, and the rotor speeds that moved the sphere there.

    Attributes
    ----------
    after : ndarray, shape (M,)
        Times of the poses after the start of the interval [s]; the last one ends it.
    poses : ndarray, shape (M, 6)
        Measured poses.
    durations : ndarray, shape (K,)
        Lengths of the straight pieces of the rotor speeds [s], which go on beyond the end of the
        interval by as much as stamps may be early.
    inputs : ndarray, shape (K + 1, 2)
        Rotor speeds at their ends [rad/s].
    lead : float
        Time from the start of the pieces to that of the interval [s]; at least the lag.
    """

    after: Vector
    poses: Vector
    durations: Vector
    inputs: Vector
    lead: float = 0.0

    @property
    def duration(self) -> float:
        """Length of the interval [s]."""
        return float(self.after[-1])

    @property
    def steepest(self) -> float:
        """Largest acceleration of the speeds [rad/s^2]."""
        slopes = np.diff(self.inputs, axis=0) / self.durations[:, None]
        return float(np.max(np.abs(slopes), initial=0.0))

    def driven(self, acceleration: float) -> "Interval":
        """Return the interval with the speeds that drives of this limit [rad/s^2] attain."""
        if self.steepest <= acceleration:
            return self
        durations, inputs = driven_speeds(self.durations, self.inputs, acceleration)
        return replace(self, durations=durations, inputs=inputs)

    def window(self, lag: float) -> tuple[Vector, Vector, list[int]]:
        """Return the speeds that moved the sphere at this lag [s], as straight pieces.

        That is their lengths [s], shape (L,), the speeds at their ends [rad/s], shape (L + 1, 2),
        and the indices of the M poses among the ends.
        """
        given = np.concatenate(([0.0], np.cumsum(self.durations))) - (self.lead - lag)
        inside = given[(given > _SAME) & (given < self.duration - _SAME)]
        times = np.unique(np.concatenate(([0.0], inside, self.after)))
        speeds: Vector = np.empty((times.size, INPUT_SIZE))
        for i in range(INPUT_SIZE):
            speeds[:, i] = np.interp(times, given, self.inputs[:, i])
        return np.diff(times), speeds, np.searchsorted(times, self.after).tolist()


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
