# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The extended Kalman filter on late, noisy, lost, out-of-order and wrong poses."""

import numpy as np

from sphere_nmpc.estimation.filter_state import FilterState, PoseNoise
from sphere_nmpc.estimation.plant_parameters import ParameterDistribution, ParameterScaling
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.state_estimator import AGREEING_OUTLIERS, HISTORY, StateEstimator
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, Vector, as_state, without_momentum

LUMPED = RobotParameters().lumped
START = as_state([0.3, -0.2, 0.5, 0.5, 0.5, 0.5])
NOISE = PoseNoise(0.005, float(np.radians(1.0)))
PERIOD = 0.05
DURATION = 6.0


def sent_inputs(rng: np.random.Generator) -> SentInputs:
    times = np.arange(0.0, DURATION + 1.0, 0.5)
    speeds = rng.uniform(-100.0, 100.0, (times.size, 2))
    speeds[0] = 0.0
    sent = SentInputs()
    sent.record(FirstOrderHold(times, speeds))
    return sent


def truths(sent: SentInputs) -> dict[float, Vector]:
    """Return the states of the robot at the times of the poses."""
    constants = LUMPED.as_array()
    states, state, time = {}, without_momentum(START), 0.0
    for k in range(round(DURATION / PERIOD) + 1):
        state = sent.predict(state, time, k * PERIOD, constants, 0.02)
        time = k * PERIOD
        states[time] = state[POSE]
    return states


def measured(rng: np.random.Generator, state: Vector) -> Vector:
    spread = np.array([NOISE.position] * 2 + [NOISE.angle] * 3)
    return apply_error(state, spread * rng.normal(size=5))


def estimator(sent: SentInputs) -> StateEstimator:
    prior = ParameterDistribution.prior(0.0)
    return StateEstimator(sent, ParameterScaling(LUMPED), prior, NOISE, FilterState)


def predicted(found: StateEstimator, time: float) -> FilterState:
    state = found.predict(time)
    assert state is not None
    return state


def normalised_error(found: StateEstimator, time: float, truth: Vector) -> float:
    """Return the squared error of the state normalised by its covariance."""
    state = predicted(found, time)
    error = error_between(state.state, truth)
    return float(error @ np.linalg.solve(state.covariance, error))


def test_estimate_is_better_than_the_poses_and_its_covariance_is_consistent() -> None:
    squares, errors = [], []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        sent = sent_inputs(rng)
        found = estimator(sent)
        for time, state in truths(sent).items():
            if rng.random() >= 0.2:
                found.observe(time, measured(rng, state))
            if time > 2.0:
                squares.append(normalised_error(found, time, state))
                errors.append(np.abs(error_between(predicted(found, time).state, state)))
    # Expected are five degrees of freedom; an overconfident filter is far above.
    assert 1.5 < np.mean(squares) < 7.0
    assert np.mean(np.array(errors)[:, :2]) < 0.5 * NOISE.position
    assert np.mean(np.array(errors)[:, 2:]) < 0.5 * NOISE.angle


def test_order_of_arrival_does_not_matter() -> None:
    rng = np.random.default_rng(10)
    sent = sent_inputs(rng)
    poses = [(time, measured(rng, state)) for time, state in truths(sent).items()]
    straight, shuffled = estimator(sent), estimator(sent)
    for pose in poses:
        straight.observe(*pose)
    for i in range(1, len(poses), 3):
        poses[i - 1 : i + 2] = poses[i - 1 : i + 2][::-1]
    for time, pose in sorted(poses[:3], key=lambda entry: entry[0]) + poses[3:]:
        assert shuffled.observe(time, pose)
    first, second = predicted(straight, DURATION), predicted(shuffled, DURATION)
    np.testing.assert_array_equal(first.state, second.state)
    np.testing.assert_array_equal(first.joint, second.joint)


def test_single_outlier_is_rejected_and_a_few_that_agree_restart_the_filter() -> None:
    rng = np.random.default_rng(11)
    found = estimator(SentInputs())
    for k in range(HISTORY + 10):
        assert found.observe(PERIOD * (k - HISTORY + 10), measured(rng, START))
    assert not found.observe(PERIOD * 15, START), "known already"
    assert not found.observe(-PERIOD * HISTORY, START), "too old"
    before = predicted(found, 1.0)
    elsewhere = apply_error(START, np.array([0.5, -0.3, 0.0, 1.0, 0.0]))
    for k in range(20, 20 + AGREEING_OUTLIERS):
        found.observe(PERIOD * k, measured(rng, elsewhere))
        if k == 20:
            after = predicted(found, 1.0)
            np.testing.assert_array_equal(before.state, after.state)
            assert len(after.outliers) == 1
    assert not predicted(found, 1.2).outliers
    assert normalised_error(found, 1.2, elsewhere) < 20.5
