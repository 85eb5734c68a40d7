# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The filter on late, noisy, lost, disordered and wrong poses."""

import numpy as np
import pytest

from sphere_nmpc.estimation.belief import PoseNoise
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.state_estimator import AGREEING, MEMORY, StateEstimator
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, as_state
from sphere_nmpc.model.tangent import deviated, deviation_between

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


def truths(sent: SentInputs, factor: float = 1.0, lag: float = 0.0) -> dict[float, Vector]:
    """Return the states of a robot whose input gain is that of the nominal one times a factor."""
    constants = LUMPED.as_array() * np.array([1.0, factor, 1.0, 1.0])
    states, state, time = {}, START, 0.0
    for k in range(round(DURATION / PERIOD) + 1):
        state = sent.predict(state, time - lag, k * PERIOD - lag, constants, 0.02)
        time = k * PERIOD
        states[time] = state
    return states


def measured(rng: np.random.Generator, state: Vector) -> Vector:
    spread = np.array([NOISE.position] * 2 + [NOISE.angle] * 3)
    return deviated(state, spread * rng.normal(size=5))


def estimator(sent: SentInputs, **changes: object) -> StateEstimator:
    return StateEstimator(sent, LUMPED, NOISE, **changes)  # type: ignore[arg-type]


def mahalanobis(found: StateEstimator, time: float, truth: Vector) -> float:
    belief = found.predict(time)
    assert belief is not None
    away = deviation_between(belief.state, truth)
    return float(away @ np.linalg.solve(belief.covariance, away))


def test_before_any_pose_nothing_is_believed() -> None:
    assert estimator(SentInputs()).predict(1.0) is None


def test_estimate_is_better_than_the_poses_and_knows_how_good_it_is() -> None:
    squares, errors = [], []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        sent = sent_inputs(rng)
        found = estimator(sent)
        for time, state in truths(sent).items():
            if rng.random() >= 0.2:
                found.observe(time, measured(rng, state))
            if time > 2.0:
                squares.append(mahalanobis(found, time, state))
                belief = found.predict(time)
                assert belief is not None
                errors.append(np.abs(deviation_between(belief.state, state)))
    # Five degrees of freedom; a filter that flattered itself would be far above.
    assert 1.5 < np.mean(squares) < 7.0
    assert np.mean(np.array(errors)[:, :2]) < 0.5 * NOISE.position
    assert np.mean(np.array(errors)[:, 2:]) < 0.5 * NOISE.angle


def test_constants_are_learnt_through_the_noise() -> None:
    rng = np.random.default_rng(7)
    sent = sent_inputs(rng)
    found = estimator(sent)
    for time, state in truths(sent, factor=1.1).items():
        found.observe(time, measured(rng, state))
    assert found.constants.input_gain / LUMPED.input_gain == pytest.approx(1.1, rel=0.01)
    assert found.outliers == 0


def test_lag_of_the_drives_is_learnt() -> None:
    rng = np.random.default_rng(8)
    sent = sent_inputs(rng)
    found = StateEstimator(sent, LUMPED, PoseNoise(1e-4, 1e-4))
    for time, state in truths(sent, lag=0.01).items():
        found.observe(time, state)
    assert found.lag == pytest.approx(0.01, abs=1e-3)


def test_without_learning_the_constants_stay() -> None:
    rng = np.random.default_rng(9)
    sent = sent_inputs(rng)
    found = estimator(sent, learning=False)
    for time, state in truths(sent, factor=1.03).items():
        found.observe(time, measured(rng, state))
    assert found.constants == LUMPED
    # What it does not know about the robot it takes for disturbances.
    assert mahalanobis(found, DURATION, truths(sent, factor=1.03)[DURATION]) < 50.0


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
    first, second = straight.predict(DURATION), shuffled.predict(DURATION)
    assert first is not None and second is not None
    np.testing.assert_array_equal(first.state, second.state)
    np.testing.assert_array_equal(first.joint, second.joint)


def test_pose_that_is_known_or_too_old_is_refused() -> None:
    found = estimator(SentInputs())
    for k in range(MEMORY + 10):
        assert found.observe(PERIOD * k, START)
    assert not found.observe(PERIOD * (MEMORY + 5), START)
    assert not found.observe(PERIOD, START)


def test_lone_outlier_is_left_out() -> None:
    rng = np.random.default_rng(11)
    found = estimator(SentInputs())
    for k in range(20):
        found.observe(PERIOD * k, measured(rng, START))
    before = found.predict(1.0)
    found.observe(1.0, deviated(START, np.array([1.0, 0.0, 0.0, 0.0, 2.0])))
    after = found.predict(1.0)
    assert before is not None and after is not None
    np.testing.assert_array_equal(before.state, after.state)
    assert found.outliers == 1 and found.jumps == 0


def test_real_jump_is_believed_after_a_few_poses_that_agree() -> None:
    rng = np.random.default_rng(12)
    found = estimator(SentInputs())
    for k in range(20):
        found.observe(PERIOD * k, measured(rng, START))
    elsewhere = deviated(START, np.array([0.5, -0.3, 0.0, 1.0, 0.0]))
    for k in range(20, 20 + AGREEING):
        found.observe(PERIOD * k, measured(rng, elsewhere))
    assert found.jumps == 1
    assert mahalanobis(found, 1.2, elsewhere) < 20.5


def test_forgetting_the_place_keeps_what_was_learnt() -> None:
    rng = np.random.default_rng(13)
    sent = sent_inputs(rng)
    found = estimator(sent)
    for time, state in truths(sent, factor=1.1).items():
        found.observe(time, measured(rng, state))
    learnt = found.constants
    found.forget()
    assert found.predict(DURATION) is None
    assert found.constants == learnt
