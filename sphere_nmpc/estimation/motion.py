# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motion over an interval, linearised in the local unknowns."""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.estimation.interval import Interval
from sphere_nmpc.estimation.unknowns import (
    CONSTANTS,
    IMBALANCE,
    KNOT,
    LAG,
    LOCAL,
    SHARE,
    Scaling,
    disturbance_of,
)
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.error_state import error_between
from sphere_nmpc.model.state import POSE, STATE_SIZE, Vector, angle_error
from sphere_nmpc.solver.roll_out import propagate, roll_out

_LAG_STEP = 1e-2
"""Step of the difference by the lag, in its unit."""
_RATE_STEP = 1e-3
"""Time over which a rate of the pose is taken [s]."""
_SHARE_STEP = 0.02
"""Step of the difference by the share, downwards: ramps of plans are slightly below the limit."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Predicted poses of an interval and knot at its end, linearised at a knot and common ones.

    Attributes
    ----------
    knot, common : ndarray, shapes (11,) and (9,)
        Where it is linearised.
    end : ndarray, shape (11,)
        Knot predicted at the end.
    by_unknowns : ndarray, shape (10, 19)
        Derivative of its error by the local unknowns [knot, common].
    innovations : ndarray, shape (M - 1, 5)
        Measured minus predicted poses within the interval.
    by_pose : ndarray, shape (M - 1, 5, 19)
        Derivatives of these predictions.
    rates : ndarray, shape (M + 1, 5)
        Rates of the pose's error at the start and at the M poses [m/s, rad/s].
    turned : float
        Angle rolled, or that the rotors ask for where it ends as it began [rad].
    """

    knot: Vector
    common: Vector
    end: Vector
    by_unknowns: Vector
    innovations: Vector
    by_pose: Vector
    rates: Vector
    turned: float


def pose_rate(
    state: Vector, speeds: Vector, constants: Vector, disturbance: Disturbance
) -> Vector:
    """Return the rate of the pose's error [m/s, rad/s], shape (5,), at rotor speeds [rad/s]."""
    held = np.array((speeds, speeds))
    later = roll_out(
        state, held, np.array([_RATE_STEP]), constants, _RATE_STEP, disturbance
    )[-1]
    found: Vector = error_between(state[POSE], later[POSE]) / _RATE_STEP
    return found


def motion(interval: Interval, knot: Vector, common: Vector, scaling: Scaling) -> Motion:
    """Return the motion over an interval from a knot on."""
    constants, nominal = scaling.constants(common), scaling.nominal.as_array()
    state, disturbance = knot[:STATE_SIZE], disturbance_of(knot, common)
    step = scaling.numbers.step
    limit, lag, count = scaling.acceleration, scaling.lag(common), interval.after.size
    driven = interval.driven(float(common[SHARE]) * limit)

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
    lower = float(common[SHARE]) - _SHARE_STEP
    if interval.steepest > lower * limit:
        by[:, :8, KNOT + SHARE] = differ(interval.driven(lower * limit), 0.0, ends, -_SHARE_STEP)
    within = zip(ends[:-1], interval.poses[:-1], strict=True)
    innovations = [error_between(end[POSE], pose) for end, pose in within]
    rates = [
        pose_rate(at, speeds[index], constants, disturbance)
        for at, index in zip((state, *ends), (0, *poses), strict=True)
    ]
    ramp = float(np.max(np.ptp(speeds, axis=0)))
    turned = angle_error(state, moved) + ramp * float(constants[1]) * interval.duration
    return Motion(
        knot, common, np.concatenate((moved, knot[STATE_SIZE:])), by[-1],
        np.array(innovations).reshape(-1, 5), by[:-1, :5], np.array(rates), turned,
    )
