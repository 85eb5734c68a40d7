# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The estimator on late, noisy, lost, out-of-order and wrong poses."""

import numpy as np
import pytest
from motions import LUMPED, START, predicted, random_ramps

from sphere_nmpc.estimation.estimator import Estimator
from sphere_nmpc.estimation.pose_filter import Estimate
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.settings import TABLE_1_NUMBERS
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.state import MOMENTUM, POSE, Vector, without_momentum
from sphere_nmpc.settings import ControllerSettings

pytestmark = pytest.mark.slow

POSITION_NOISE, ANGLE_NOISE = 0.005, float(np.radians(1.0))
SETTINGS = ControllerSettings(
    pose_position_noise=POSITION_NOISE, pose_orientation_noise=ANGLE_NOISE
)
SPREAD = np.array([POSITION_NOISE] * 2 + [ANGLE_NOISE] * 3)
PERIOD = 0.05
DURATION = 6.0


def truths(sent: SentInputs) -> dict[float, Vector]:
    """Return the poses of the robot at the times at which they are measured."""
    poses, state, time = {}, without_momentum(START), 0.0
    for k in range(round(DURATION / PERIOD) + 1):
        state = predicted(sent, state, time, k * PERIOD, LUMPED.as_array())
        time = k * PERIOD
        poses[time] = state[POSE]
    return poses


def measured(rng: np.random.Generator, pose: Vector) -> Vector:
    return apply_error(pose, SPREAD * rng.normal(size=5))


def estimated(found: Estimator, time: float) -> Estimate:
    estimate = found.estimate(time)
    assert estimate is not None
    return estimate


def normalised_error(estimate: Estimate, truth: Vector) -> float:
    """Return the squared error of the pose normalised by its covariance."""
    assert estimate.covariance is not None
    error = error_between(estimate.state[POSE], truth)
    return float(error @ np.linalg.solve(estimate.covariance, error))


def test_estimate_is_better_than_the_poses_and_its_covariance_is_consistent() -> None:
    squares, errors = [], []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        sent = random_ramps(rng, DURATION + 1.0)
        found = Estimator(SETTINGS, LUMPED, sent)
        for time, pose in truths(sent).items():
            if time == 0.0 or rng.random() >= 0.2:
                found.observe(time, measured(rng, pose))
            estimate = estimated(found, time)
            if time > 2.0:
                assert not estimate.state[MOMENTUM].any()
                squares.append(normalised_error(estimate, pose))
                errors.append(np.abs(error_between(estimate.state[POSE], pose)))
    # Expected are five degrees of freedom; an overconfident filter is far above.
    assert 1.5 < np.mean(squares) < 7.0
    assert np.mean(np.array(errors)[:, :2]) < 0.5 * POSITION_NOISE
    assert np.mean(np.array(errors)[:, 2:]) < 0.5 * ANGLE_NOISE


def test_order_of_arrival_does_not_matter_within_an_interval() -> None:
    rng = np.random.default_rng(10)
    sent = random_ramps(rng, DURATION + 1.0)
    straight, shuffled = (Estimator(SETTINGS, LUMPED, sent) for _ in range(2))
    poses = [(time, measured(rng, pose)) for time, pose in truths(sent).items()]
    for i in range(0, len(poses) // 2, 4):
        # The first of four ends an interval.
        group = poses[i : i + 4]
        for one, other in zip(group, [group[0], *group[:0:-1]], strict=True):
            assert straight.observe(*one)
            assert shuffled.observe(*other)
        first, second = (estimated(found, group[-1][0]) for found in (straight, shuffled))
        np.testing.assert_array_equal(first.state, second.state)
        np.testing.assert_array_equal(first.covariance, second.covariance)
    assert not straight.observe(*group[2]), "known already"
    assert not straight.observe(group[0][0] - 3.0, group[0][1]), "too old"


def test_single_outlier_is_rejected_and_a_few_are_believed() -> None:
    rng = np.random.default_rng(11)
    found = Estimator(SETTINGS, LUMPED, SentInputs())
    elsewhere = apply_error(START, np.array([0.05, -0.03, 0.0, 0.2, 0.0]))
    for k in range(60):
        found.observe(PERIOD * k, measured(rng, elsewhere if k in (31, 45) else START))
        if k > 4:
            # The square of five standard deviations and more.
            assert normalised_error(estimated(found, PERIOD * k), START) < 30.0, k
    for k in range(60, 80):
        found.observe(PERIOD * k, measured(rng, elsewhere))
        estimate = estimated(found, PERIOD * k)
        if k >= 60 + TABLE_1_NUMBERS.most_outliers:
            assert normalised_error(estimate, elsewhere) < 30.0, k
    assert not estimate.state[MOMENTUM].any(), "it has been carried, not pushed"
