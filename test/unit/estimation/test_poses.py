# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The estimator on exact and noisy, lost, late and wrong poses, also of a robot with momentum."""

from dataclasses import replace

import numpy as np
import pytest
from delayed_worker import DelayedWorker
from motions import LUMPED, START, predicted, random_ramps
from scipy.stats import chi2

from sphere_nmpc.estimation.estimator import Estimator
from sphere_nmpc.estimation.pose_filter import Estimate
from sphere_nmpc.estimation.rotor_history import RotorHistory
from sphere_nmpc.estimation.settings import TABLE_1_NUMBERS
from sphere_nmpc.model.disturbance import (
    UNDISTURBED,
    Disturbance,
    is_zero,
    momentum_of_push,
    slope_torque,
)
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import MOMENTUM, POSE, Vector, without_momentum
from sphere_nmpc.settings import ControllerSettings

pytestmark = pytest.mark.slow

ROBOT = RobotParameters()
KNOWN = LUMPED.as_array()
OTHERS = KNOWN * np.array([1.0, 1.03, 0.99, 1.01])
EXACT = ControllerSettings()
NOISY = ControllerSettings(pose_position_noise=5e-3, pose_orientation_noise=float(np.radians(1.0)))
SPREAD = np.repeat([NOISY.pose_position_noise, NOISY.pose_orientation_noise], (2, 3))
BOTH = pytest.mark.parametrize("settings", [EXACT, NOISY], ids=["exact", "noisy"])
PERIOD = 0.05
"""Period of noisy poses [s]; that of exact ones is five times as long."""
SLOPE = slope_torque(ROBOT, np.radians(0.3), -1.0)
PUSH = momentum_of_push(ROBOT, np.array([0.3, -0.4]))
PUSH_TIME = 3.1


class Run:
    """A robot that follows ramps, and the estimator that sees its poses."""

    def __init__(
        self, settings: ControllerSettings, disturbance: Disturbance = UNDISTURBED, seed: int = 1,
        constants: Vector = OTHERS, largest: float = 60.0, loss: float = 0.0,
        worker: DelayedWorker | None = None,
    ) -> None:
        self.rng = np.random.default_rng(seed)
        self.sent = random_ramps(self.rng, 20.0, largest)
        self.estimator = Estimator(settings, LUMPED, self.sent, worker=worker)
        self.is_noisy = settings.pose_position_noise > 0.0
        self.constants, self.disturbance, self.loss = constants, disturbance, loss
        self.time, self.state = 0.0, without_momentum(START)
        self.observe()

    def measured(self) -> Vector:
        return apply_error(self.state[POSE], self.is_noisy * SPREAD * self.rng.normal(size=5))

    def observe(self) -> None:
        assert self.estimator.observe(self.time, self.measured())
        self.estimate = estimated(self.estimator, self.time)

    def advance(self, until: float) -> None:
        self.state = predicted(
            self.sent, self.state, self.time, until, self.constants, self.disturbance
        )
        self.time = until

    def go(self, until: float, push: Vector | None = None) -> None:
        """Continue to a time [s]; the push comes at `PUSH_TIME`."""
        period = PERIOD if self.is_noisy else 5.0 * PERIOD
        first, last = round(self.time / period) + 1, round(until / period)
        for k in range(first, last + 1):
            if push is not None and k * period >= PUSH_TIME:
                self.advance(PUSH_TIME)
                self.state[MOMENTUM] += push
                push = None
            self.advance(k * period)
            if self.rng.random() >= self.loss:
                self.observe()
        self.estimate = estimated(self.estimator, self.time)

    def momentum_error(self) -> float:
        return float(np.linalg.norm((self.estimate.state - self.state)[MOMENTUM]))


def estimated(found: Estimator, time: float) -> Estimate:
    estimate = found.estimate(time)
    assert estimate is not None
    return estimate


def normalised_error(estimate: Estimate, truth: Vector) -> float:
    """Return the squared error of the pose normalised by its covariance."""
    error = error_between(estimate.state[POSE], truth)
    return float(error @ np.linalg.solve(estimate.covariance, error))


def is_paper(found: Estimate) -> bool:
    return is_zero(found.state[MOMENTUM], found.disturbance)


def test_estimate_is_better_than_the_poses() -> None:
    errors = []
    for seed in range(2):
        run = Run(NOISY, seed=seed, constants=KNOWN, largest=100.0, loss=0.2)
        for k in range(1, 121):
            run.go(k * PERIOD)
            if run.time > 2.0:
                assert is_paper(run.estimate)
                errors.append(np.abs(error_between(run.estimate.state[POSE], run.state[POSE])))
    assert np.all(np.mean(errors, axis=0) < 0.5 * SPREAD)


def test_errors_of_the_pose_filter_are_as_large_as_its_covariance_says() -> None:
    """Over robots as the prior expects them, of which nothing is learnt."""
    squares, rng = [], np.random.default_rng(0)
    busy = DelayedWorker(lambda: 0.0, 0.0)
    busy.busy = True
    for seed in range(300):
        constants = KNOWN * (1.0 + np.array(TABLE_1_NUMBERS.constants) * rng.normal(size=4))
        run = Run(NOISY, UNDISTURBED, seed, constants, 100.0, 0.2, busy)
        run.go(1.0)
        squares.append(normalised_error(run.estimate, run.state[POSE]))
    # Of 300 robots with five degrees of freedom, 99.8 % of the sums are between these.
    least, most = chi2.ppf((1e-3, 1.0 - 1e-3), 5 * len(squares)) / len(squares)
    assert least < np.mean(squares) < most


def test_order_of_arrival_does_not_matter_within_an_interval() -> None:
    run, poses = Run(NOISY, seed=10, constants=KNOWN), []
    for k in range(1, 61):
        run.advance(k * PERIOD)
        poses.append((run.time, run.measured()))
    straight, shuffled = (Estimator(NOISY, LUMPED, run.sent) for _ in range(2))
    for i in range(0, len(poses), 4):
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
    rng, found = np.random.default_rng(11), Estimator(NOISY, LUMPED, RotorHistory())
    elsewhere = apply_error(START, np.array([0.05, -0.03, 0.0, 0.2, 0.0]))
    for k in range(80):
        seen = elsewhere if k in (31, 45) or k >= 60 else START
        found.observe(PERIOD * k, apply_error(seen, SPREAD * rng.normal(size=5)))
        estimate = estimated(found, PERIOD * k)
        # The square of five standard deviations and more.
        if 4 < k < 60:
            assert normalised_error(estimate, START) < 30.0, k
        if k >= 60 + TABLE_1_NUMBERS.most_outliers:
            assert normalised_error(estimate, elsewhere) < 30.0, k
    assert not estimate.state[MOMENTUM].any(), "it has been carried, not pushed"


@BOTH
def test_nothing_is_invented_before_a_push_and_that_is_estimated(
    settings: ControllerSettings,
) -> None:
    run, paper = Run(settings), Run(replace(settings, momentum=False))
    for until in (1.0, 2.0, 3.0):
        run.go(until)
        paper.go(until)
        assert is_paper(run.estimate)
        np.testing.assert_array_equal(run.estimate.state, paper.estimate.state)
        assert run.estimate.plant.constants == paper.estimate.plant.constants
    if settings is EXACT:
        run.go(3.5, PUSH)
        assert run.momentum_error() < 0.02 * np.linalg.norm(PUSH), "two samples are enough"
    run.go(6.0, PUSH if settings is NOISY else None)
    assert run.momentum_error() < (3.0 if settings is NOISY else 0.05)


@BOTH
def test_slope_is_estimated_survives_forgotten_poses_and_is_switched_off_and_on(
    settings: ControllerSettings,
) -> None:
    # Noise of 5 mm and 1 degree at 20 Hz: the rate of turn of a second is known to 0.01 rad/s,
    # that is the momentum to 0.6 rad/s; four seconds improve it, wrong constants do not.
    momentum, slope = (2.0, 0.8) if settings is NOISY else (0.05, 0.1)
    run = Run(settings, Disturbance(SLOPE))
    run.go(6.0)
    assert run.momentum_error() < momentum
    np.testing.assert_allclose(run.estimate.disturbance.slope, SLOPE, atol=slope)
    # It is predicted to the time of the estimate. The imbalance that is estimated beside the slope
    # is within its own error of zero.
    found = run.estimator
    gained = (estimated(found, run.time + 0.4).state - run.estimate.state)[MOMENTUM]
    np.testing.assert_allclose(gained[:2], 0.4 * SLOPE, atol=0.4)

    found.change(replace(settings, momentum=False))
    assert is_paper(estimated(found, run.time))
    found.change(settings)
    before = (*found.momentum, *found.disturbance.as_array())
    found.forget()
    run.observe()
    assert (*found.momentum, *found.disturbance.as_array()) == before
    run.go(10.0)
    assert run.momentum_error() < 2.0 * momentum


def test_floor_that_tilts_is_noticed_and_a_robot_that_was_carried_is_not_pushed() -> None:
    run = Run(EXACT)
    run.go(3.0)
    run.state = run.state + np.array([0.3, -0.2, *np.zeros(7)])
    run.go(5.0)
    assert is_paper(run.estimate)
    run = Run(EXACT)
    run.go(3.0)
    for slope in (SLOPE, -SLOPE):
        run.disturbance = Disturbance(slope)
        run.go(run.time + 3.5)
        assert run.momentum_error() < 0.1
        np.testing.assert_allclose(run.estimate.disturbance.slope, slope, atol=0.2)
