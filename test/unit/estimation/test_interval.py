# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rotors that fall behind the speeds sent, against a simulation in short steps."""

import numpy as np
import pytest

from sphere_nmpc.estimation.motion import Interval
from sphere_nmpc.model.state import Vector

LIMIT = 300.0
STEP = 1e-5


def simulated(durations: Vector, inputs: Vector, limit: float) -> Vector:
    """Return the speeds (n, 2) every STEP of rotors that follow by at most `limit`."""
    given = np.concatenate(([0.0], np.cumsum(durations)))
    times = np.arange(0.0, given[-1] + 0.5 * STEP, STEP)
    sent = np.column_stack([np.interp(times, given, column) for column in inputs.T])
    followed = [sent[0]]
    for wanted in sent[1:]:
        reach = limit * STEP
        followed.append(np.clip(wanted, followed[-1] - reach, followed[-1] + reach))
    return np.array(followed)


@pytest.mark.parametrize("seed", range(2))
def test_rotors_fall_behind_and_catch_up_as_simulated(seed: int) -> None:
    rng = np.random.default_rng(seed)
    durations = rng.uniform(0.05, 0.25, 8)
    inputs = rng.uniform(-100.0, 100.0, (9, 2))
    raw = Interval(np.array([1.0]), np.zeros((1, 6)), durations, inputs)
    driven = raw.driven(LIMIT)
    times, speeds = driven.durations, driven.inputs
    expected = simulated(durations, inputs, LIMIT)
    at = np.arange(len(expected)) * STEP
    corners = np.concatenate(([0.0], np.cumsum(times)))
    found = np.column_stack([np.interp(at, corners, column) for column in speeds.T])
    # A step of the simulation at the limit, and one of the steepest ramp.
    assert np.max(np.abs(found - expected)) < 2.0 * STEP * 200.0 / 0.05
    slopes = np.diff(speeds, axis=0) / times[:, None]
    assert np.max(np.abs(slopes)) <= LIMIT * (1.0 + 1e-6)
    assert np.array_equal(raw.driven(raw.steepest).inputs, inputs)


def test_window_is_shifted_by_the_lag_and_ends_at_the_poses() -> None:
    durations, inputs = np.array([0.2, 0.3, 0.5]), np.array([[0.0, 1], [2, 3], [8, 0], [3, 5.0]])
    after = np.array([0.1, 0.35, 0.6])
    interval = Interval(after, np.zeros((3, 6)), durations, inputs, lead=0.4)
    for lag in (0.0, 0.04):
        pieces, speeds, poses = interval.window(lag)
        times = np.concatenate(([0.0], np.cumsum(pieces)))
        np.testing.assert_allclose(times[poses], after)
        for i in range(2):
            wanted = np.interp(0.4 - lag + times, [0.0, 0.2, 0.5, 1.0], inputs[:, i])
            np.testing.assert_allclose(speeds[:, i], wanted, atol=1e-12)
        assert 0.1 + lag in np.round(times, 12), "the knot within"
