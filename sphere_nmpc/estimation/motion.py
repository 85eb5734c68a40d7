# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Interval between two knots: poses, speeds, and the motion, linearised in the local unknowns."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.estimation.posterior import (
    CONSTANTS,
    IMBALANCE,
    KNOT,
    LAG,
    LOCAL,
    SHARE,
    SHARE_STEP,
    Scaling,
    disturbance_of,
)
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.error_state import error_between
from sphere_nmpc.model.first_order_hold import SAME, SHORTEST
from sphere_nmpc.model.rotation import vertical
from sphere_nmpc.model.state import INPUT_SIZE, POSE, QUATERNION, STATE_SIZE, Vector, angle_error
from sphere_nmpc.model.torque import attainable, largest_shares
from sphere_nmpc.solver.roll_out import propagate, roll_out

_LAG_STEP = 1e-2
"""Step of the difference by the lag, in its unit."""


@dataclass(frozen=True, eq=False)
class Interval:
    """Poses measured in an interval, and the rotor speeds that moved the sphere there."""

    after: Vector
    """Times of the poses after the start of the interval [s], shape (M,); the last one ends it."""
    poses: Vector
    """Measured poses, shape (M, 6)."""
    durations: Vector
    """Lengths of the straight pieces of the rotor speeds [s], shape (K,), which go on beyond the
    end of the interval by as much as stamps may be early."""
    inputs: Vector
    """Rotor speeds at their ends [rad/s], shape (K + 1, 2)."""
    lead: float = 0.0
    """Time from the start of the pieces to that of the interval [s]; at least the lag."""

    @property
    def duration(self) -> float:
        """Length of the interval [s]."""
        return float(self.after[-1])

    @property
    def steepest(self) -> float:
        """Largest acceleration of the speeds [rad/s^2]."""
        slopes = np.diff(self.inputs, axis=0) / self.durations[:, None]
        return float(np.max(np.abs(slopes), initial=0.0))

    def driven(
        self, acceleration: float, state: Vector, constants: Vector, step: float
    ) -> "Interval":
        """Return the interval with the speeds that drives of limited torque attain.

        The torque is that of `acceleration` [rad/s^2] in space, so that the acceleration relative
        to the shell depends on the orientation, which counts once in each `step` [s]; `state` is
        that at the start of the interval. A rotor that has fallen behind turns at the limit until
        it has caught up. At the start of the pieces it has the speed that was sent.
        """
        share, turning = largest_shares(constants)
        if share * self.steepest + turning * np.max(np.abs(self.inputs)) ** 2 <= acceleration:
            return self
        given = np.concatenate(([0.0], np.cumsum(self.durations)))
        times = _distinct(given, [self.lead], np.arange(0.0, given[-1], step))
        sent = np.column_stack([np.interp(times, given, column) for column in self.inputs.T])
        durations, begin = np.diff(times), int(np.searchsorted(times, self.lead - SAME))
        # Back in time the same path is rolled with the opposite speeds.
        back = roll_out(state[POSE], -sent[begin::-1], durations[:begin][::-1], constants)
        verticals = vertical(roll_out(back[-1], sent, durations, constants)[:, QUATERNION])
        verticals, middle = (0.5 * (one[:-1] + one[1:]) for one in (verticals, sent))
        verticals /= np.linalg.norm(verticals, axis=1, keepdims=True)
        slopes = np.diff(sent, axis=0) / durations[:, None]
        limits = attainable(acceleration, verticals, middle, slopes, constants)
        paths = [followed(times, *each) for each in zip(sent.T, *limits, strict=True)]
        times = _distinct(times, *(path[0] for path in paths))
        speeds = np.column_stack([np.interp(times, *path) for path in paths])
        return replace(self, durations=np.diff(times), inputs=speeds)

    def window(self, lag: float) -> tuple[Vector, Vector, list[int]]:
        """Return the speeds that moved the sphere at this lag [s], as straight pieces.

        That is their lengths [s], shape (L,), the speeds at their ends [rad/s], shape (L + 1, 2),
        and the indices of the M poses among the ends.
        """
        given = np.concatenate(([0.0], np.cumsum(self.durations))) - (self.lead - lag)
        inside = given[(given > SAME) & (given < self.duration - SAME)]
        times = np.unique(np.concatenate(([0.0], inside, self.after)))
        speeds: Vector = np.empty((times.size, INPUT_SIZE))
        for i in range(INPUT_SIZE):
            speeds[:, i] = np.interp(times, given, self.inputs[:, i])
        return np.diff(times), speeds, np.searchsorted(times, self.after).tolist()


def _distinct(*times: Iterable[float]) -> Vector:
    """Return all times in order; of those that are the same the first one."""
    merged: Vector = np.sort(np.concatenate([list(some) for some in times]))
    return merged[np.diff(merged, prepend=-np.inf) > SAME]


def followed(
    times: Vector, sent: Vector, low: Vector, high: Vector
) -> tuple[list[float], list[float]]:
    """Return times [s] and speeds [rad/s] of the corners of one rotor's motion.

    Between the times its acceleration is at least that of `low`, and at most that of `high`.
    """
    now, speed = float(times[0]), float(sent[0])
    corners, speeds = [now], [speed]
    ends, wants = times.tolist(), sent.tolist()
    pieces = zip(ends, ends[1:], wants, wants[1:], low.tolist(), high.tolist(), strict=False)
    for begin, end, before, wanted, least, largest in pieces:
        if not end - begin > SAME:
            continue
        slope = (wanted - before) / (end - begin)
        behind = wanted - slope * (end - now) - speed
        while end - now > SAME:
            if abs(behind) < SAME:
                rate, lasts = min(max(slope, least), largest), end - now
            else:
                rate = largest if behind > 0.0 else least
                closing = (rate - slope) * (1.0 if behind > 0.0 else -1.0)
                caught = abs(behind) / closing if closing > 0.0 else np.inf
                lasts = min(caught, end - now)
            now, speed = now + lasts, speed + rate * lasts
            behind += (slope - rate) * lasts
            corners.append(now)
            speeds.append(speed)
    return corners, speeds


@dataclass(frozen=True, eq=False)
class Motion:
    """Predicted poses of an interval and knot at its end, linearised at a knot and common ones."""

    interval: Interval
    """Measured poses, and the rotor speeds."""
    knot: Vector
    common: Vector
    """Point of the linearisation: knot and common unknowns, shapes (11,) and (9,)."""
    end: Vector
    """Knot predicted at the end, shape (11,)."""
    by_unknowns: Vector
    """Derivative of its error by the local unknowns [knot, common], shape (10, 19)."""
    innovations: Vector
    """Measured minus predicted poses within the interval, shape (M - 1, 5)."""
    by_pose: Vector
    """Derivatives of these predictions, shape (M - 1, 5, 19)."""
    rates: Vector
    """Rates of the pose's error at the start and at the M poses [m/s, rad/s], shape (M + 1, 5)."""
    turned: float
    """Angle rolled, or that the rotors ask for where it ends as it began [rad]."""


def pose_rate(
    state: Vector, speeds: Vector, constants: Vector, disturbance: Disturbance
) -> Vector:
    """Return the rate of the pose's error [m/s, rad/s], shape (5,), at rotor speeds [rad/s]."""
    held = np.array((speeds, speeds))
    later = roll_out(
        state, held, np.array([SHORTEST]), constants, SHORTEST, disturbance
    )[-1]
    found: Vector = error_between(state[POSE], later[POSE]) / SHORTEST
    return found


def motion(interval: Interval, knot: Vector, common: Vector, scaling: Scaling) -> Motion:
    """Return the motion over an interval from a knot on."""
    constants, nominal = scaling.constants(common), scaling.nominal.as_array()
    state, disturbance = knot[:STATE_SIZE], disturbance_of(knot, common)
    step = scaling.numbers.step
    limit, lag, count = scaling.acceleration, scaling.lag(common), interval.after.size
    share = float(common[SHARE])
    driven = interval.driven(share * limit, state, constants, step) if share < 1.0 else interval

    def differ(other: Interval, longer: float, ends: Vector, change: float) -> Vector:
        durations, speeds, poses = other.window(lag + longer)
        states = roll_out(state, speeds, durations, constants, step, disturbance)[poses]
        moved = [error_between(a, b) for a, b in zip(ends, states, strict=True)]
        return np.array(moved) / change

    durations, speeds, poses = driven.window(lag)
    ends, by = np.empty((count, STATE_SIZE)), np.zeros((count, KNOT, LOCAL))
    by[:, 8:, 8:KNOT] = np.eye(2)
    moved, by_start, first = state, np.eye(8), 0
    by_others: Vector = np.zeros((8, 9))
    for m, last in enumerate(poses):
        part = propagate(
            moved, speeds[first : last + 1], durations[first:last], constants, step, disturbance
        )
        by_start = part.by_start @ by_start
        by_others = part.by_start @ by_others
        by_others[:, :4] += part.by_constants
        by_others[:, 4:] += part.by_torques
        moved, first = part.state, last
        ends[m], by[m, :8, :8] = moved, by_start
        by[m, :8, KNOT:][:, CONSTANTS] = by_others[:, :4] * nominal
        by[m, :8, 8:KNOT] = by_others[:, 4:6]
        by[m, :8, KNOT:][:, IMBALANCE] = by_others[:, 6:]
    # Inwards at the longest lag, where the window would begin before the lead.
    change = _LAG_STEP if lag < 0.5 * scaling.numbers.longest_lag else -_LAG_STEP
    by[:, :8, KNOT + LAG] = differ(driven, change * scaling.numbers.lag, ends, change)
    # Downwards, as ramps of plans are slightly less steep than the limit.
    weaker = interval.driven((share - SHARE_STEP) * limit, state, constants, step)
    if weaker is not interval:
        by[:, :8, KNOT + SHARE] = differ(weaker, 0.0, ends, -SHARE_STEP)
    within = zip(ends[:-1], interval.poses[:-1], strict=True)
    innovations = [error_between(end[POSE], pose) for end, pose in within]
    rates = [
        pose_rate(at, speeds[index], constants, disturbance)
        for at, index in zip((state, *ends), (0, *poses), strict=True)
    ]
    ramp = float(np.max(np.ptp(speeds, axis=0)))
    turned = angle_error(state, moved) + ramp * float(constants[1]) * interval.duration
    return Motion(
        interval, knot, common, np.concatenate((moved, knot[STATE_SIZE:])), by[-1],
        np.array(innovations).reshape(-1, 5), by[:-1, :5], np.array(rates), turned,
    )
