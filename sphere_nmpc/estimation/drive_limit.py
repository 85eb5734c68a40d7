# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motion of rotors whose drives attain less acceleration than the speeds sent ask for."""

import numpy as np

from sphere_nmpc.model.state import Vector

_SAME = 1e-9
"""Time [s] and speed [rad/s] below which two are the same."""


def driven_speeds(
    durations: Vector, inputs: Vector, acceleration: float
) -> tuple[Vector, Vector]:
    """Return the pieces of rotors that follow straight pieces at a limited acceleration.

    A rotor that has fallen behind turns at the limit until it has caught up. At the start it has
    the speed that was sent.

    Parameters
    ----------
    durations : ndarray, shape (K,)
        Lengths of the pieces sent [s].
    inputs : ndarray, shape (K + 1, 2)
        Speeds sent at their ends [rad/s].
    acceleration : float
        Largest acceleration of the rotors [rad/s^2].

    Returns
    -------
    durations : ndarray, shape (L,)
    inputs : ndarray, shape (L + 1, 2)
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
