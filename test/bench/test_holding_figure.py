# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of docs/momentum.md: its times are the limits stated there, and its runs are drawn."""

import math

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("mujoco")

from holding_figure import (
    PUSH,
    ROBOT,
    START,
    run,
    time_out_of_balance,
    times_on_slope,
)

from sphere_nmpc.model.drift import Drift, imbalance_of_offset
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.saturation import time_to_saturation
from sphere_sim.evaluation.metrics import SETTLED_ERROR


def test_time_on_a_slope_is_that_of_one_rotor_and_at_best_of_both() -> None:
    force = ROBOT.total_mass * 9.81 * math.sin(math.radians(0.5))
    stored = ROBOT.rotor_axial_inertia * ROBOT.max_rotor_speed
    worst, best = times_on_slope(math.radians(0.5))
    assert worst == pytest.approx(stored / (force * ROBOT.shell_radius))
    assert best == pytest.approx(math.sqrt(2.0) * worst)


def test_no_orientation_is_worse_than_the_worst() -> None:
    rng = np.random.default_rng(0)
    shortest = time_out_of_balance(1e-3)
    for _ in range(200):
        offset = rng.normal(size=3)
        offset *= 1e-3 / np.linalg.norm(offset)
        drift = Drift(imbalance=imbalance_of_offset(ROBOT, offset))
        found = time_to_saturation(drift, random_quaternion(rng), ROBOT.max_rotor_speed)
        assert found >= shortest * (1.0 - 1e-12)  # rounding


def test_pushed_sphere_settles_with_its_momentum_in_a_rotor() -> None:
    held = run(PUSH.time + 3.0, START, push=PUSH)
    expected = ROBOT.shell_radius * PUSH.impulse[0] / ROBOT.rotor_axial_inertia
    before = (held.times > PUSH.time - 1.0) & (held.times < PUSH.time)
    assert np.max(held.errors[before]) < SETTLED_ERROR
    assert np.max(held.errors[held.times > PUSH.time + 2.5]) < SETTLED_ERROR
    # 1 rad/s lets the sphere roll by 5 mm/s, which would leave the goal within two seconds.
    np.testing.assert_allclose(held.speeds[-1], [0.0, expected], atol=1.0)
    np.testing.assert_allclose(held.rest_speeds[-1], [0.0, expected], atol=1.0)
    assert held.samples.size == len(held.rest_speeds)
