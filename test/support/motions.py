# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motions that rotor speeds lead to, by the compiled model and by CasADi, and paths in R^n."""

from collections.abc import Iterable

import numpy as np

from sphere_nmpc.estimation.rotor_history import RotorHistory
from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.integrator import step_function, steps_for
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, as_state
from sphere_nmpc.model.units import DEFAULT_MAX_STEP
from sphere_nmpc.solver.roll_out import roll_out

LUMPED = RobotParameters().lumped
START = as_state([0.3, -0.2, 0.5, 0.5, 0.5, 0.5])


def integrate(
    state: Vector, u_start: Vector, u_end: Vector, duration: float, constants: Vector,
    max_step: float = DEFAULT_MAX_STEP,
) -> Vector:
    """Return the pose after one interval of a first-order hold (Eq. 20 with Eq. 21), by CasADi.

    From a pose, shape (6,), with the rotor speeds at both ends [rad/s], shape (2,), over
    `duration` [s] in steps of `max_step` [s] at most; `constants` are [Rs, c1, r1, r3].
    """
    steps = steps_for(duration, max_step)
    step, h = step_function(), duration / steps
    x: Vector = state
    for i in range(steps):
        here, there = (u_start + (u_end - u_start) * (k / steps) for k in (i, i + 1))
        x = np.array(step(x, here, there, h, constants)).ravel()
    return x


def random_ramps(rng: np.random.Generator, until: float, largest: float = 100.0) -> RotorHistory:
    """Return ramps of 0.5 s between random speeds up to `largest` [rad/s], from rest at 0 s."""
    times = np.arange(0.0, until, 0.5)
    speeds = rng.uniform(-largest, largest, (times.size, 2))
    speeds[0] = 0.0
    sent = RotorHistory()
    sent.record(FirstOrderHold(times, speeds))
    return sent


def predicted(
    sent: RotorHistory, state: Vector, start: float, end: float, constants: Vector,
    disturbance: Disturbance = UNDISTURBED,
) -> Vector:
    """Return the state, (9,), at `end` [s] from that at `start` by the speeds sent."""
    if end <= start:
        return state
    durations, speeds = sent.pieces(start, end)
    return roll_out(state, speeds, durations, constants, 0.02, disturbance)[-1].copy()


def moved(
    start: Vector, hold: FirstOrderHold, since: float, until: float, spacing: float
) -> Vector:
    """Return the states from `start`, (9,), on along a hold, at knots and `spacing` [s] apart."""
    knots = np.array(hold.knots_between(since, until))
    times = np.unique(np.concatenate((np.arange(since, until, spacing), knots, [until])))
    speeds = hold.resampled(times).speeds
    return roll_out(start, speeds, np.diff(times), LUMPED.as_array(), spacing)


def largest_slope(hold: FirstOrderHold) -> float:
    """Return the largest acceleration of either rotor along a hold [rad/s^2]."""
    slopes = np.diff(hold.speeds, axis=0) / np.diff(hold.times)[:, None]
    return float(np.max(np.abs(slopes), initial=0.0))


def largest_distance(points: Iterable[Vector], path: Vector) -> float:
    """Return the largest distance of points from a path of straight pieces, both in R^n."""
    way = np.diff(path, axis=0)
    length = np.maximum(np.sum(way * way, axis=1), 1e-18)
    largest = 0.0
    for point in points:
        share = np.clip(np.sum((point - path[:-1]) * way, axis=1) / length, 0.0, 1.0)
        near = path[:-1] + share[:, None] * way
        largest = max(largest, float(np.min(np.linalg.norm(near - point, axis=1))))
    return largest
