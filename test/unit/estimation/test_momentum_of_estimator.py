# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Both estimators behind the contract on a robot that is pushed or stands on a slope."""

from dataclasses import replace

import numpy as np
import pytest
from motions import START, predicted, random_ramps

from sphere_nmpc.estimation.estimator import Estimator
from sphere_nmpc.estimation.pose_filter import Estimate
from sphere_nmpc.model.disturbance import (
    UNDISTURBED,
    Disturbance,
    is_zero,
    momentum_of_push,
    slope_torque,
)
from sphere_nmpc.model.error_state import apply_error
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import MOMENTUM, POSE, Vector, without_momentum
from sphere_nmpc.settings import ControllerSettings

pytestmark = pytest.mark.slow

ROBOT = RobotParameters()
CONSTANTS = ROBOT.lumped.as_array() * np.array([1.0, 1.03, 0.99, 1.01])
EXACT = ControllerSettings()
NOISY = ControllerSettings(pose_position_noise=5e-3, pose_orientation_noise=float(np.radians(1.0)))
BOTH = pytest.mark.parametrize("settings", [EXACT, NOISY], ids=["exact", "noisy"])
EXACT_PERIOD, NOISY_PERIOD = 0.25, 0.05
SLOPE = slope_torque(ROBOT, np.radians(0.3), -1.0)
PUSH = momentum_of_push(ROBOT, np.array([0.3, -0.4]))
PUSH_TIME = 3.1


class Run:
    """A robot that follows ramps, and the estimator that sees its poses."""

    def __init__(self, settings: ControllerSettings, disturbance: Disturbance) -> None:
        rng = np.random.default_rng(1)
        self.sent = random_ramps(rng, 20.0, 60.0)
        self.estimator: Estimator = Estimator(settings, ROBOT.lumped, self.sent)
        self.noisy = settings.pose_position_noise > 0.0
        self.deviations = np.array(
            [settings.pose_position_noise] * 2 + [settings.pose_orientation_noise] * 3
        )
        self.rng, self.time, self.disturbance = rng, 0.0, disturbance
        self.state = without_momentum(START)
        self.observe()

    def observe(self) -> None:
        pose = apply_error(self.state[POSE], self.deviations * self.rng.normal(size=5))
        assert self.estimator.observe(self.time, pose)
        self.estimate: Estimate = self.estimated(self.time)

    def estimated(self, time: float) -> Estimate:
        found = self.estimator.estimate(time)
        assert found is not None
        return found

    def advance(self, until: float) -> None:
        self.state = predicted(
            self.sent, self.state, self.time, until, CONSTANTS, self.disturbance
        )
        self.time = until

    def go(self, until: float, push: Vector | None = None) -> None:
        """Continue to a time [s]; the push comes at `PUSH_TIME`."""
        period = NOISY_PERIOD if self.noisy else EXACT_PERIOD
        first, last = round(self.time / period) + 1, round(until / period)
        for k in range(first, last + 1):
            if push is not None and k * period >= PUSH_TIME:
                self.advance(PUSH_TIME)
                self.state[MOMENTUM] += push
                push = None
            self.advance(k * period)
            self.observe()

    def momentum_error(self) -> float:
        return float(np.linalg.norm((self.estimate.state - self.state)[MOMENTUM]))


def is_paper(found: Estimate) -> bool:
    return is_zero(found.state[MOMENTUM], found.disturbance)


def known(estimator: Estimator) -> Vector:
    return np.concatenate((estimator.momentum, estimator.disturbance.as_array()))


@BOTH
def test_nothing_is_invented_before_a_push_and_that_is_estimated(
    settings: ControllerSettings,
) -> None:
    run, paper = Run(settings, UNDISTURBED), Run(replace(settings, momentum=False), UNDISTURBED)
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
    later = run.estimated(run.time + 0.4)
    gained = (later.state - run.estimate.state)[MOMENTUM]
    np.testing.assert_allclose(gained[:2], 0.4 * SLOPE, atol=0.4)

    run.estimator.change(replace(settings, momentum=False))
    assert is_paper(run.estimated(run.time))
    run.estimator.change(settings)
    before = known(run.estimator)
    run.estimator.forget()
    run.observe()
    np.testing.assert_array_equal(known(run.estimator), before)
    run.go(10.0)
    assert run.momentum_error() < 2.0 * momentum


def test_floor_that_tilts_is_noticed_and_a_robot_that_was_carried_is_not_pushed() -> None:
    run = Run(EXACT, UNDISTURBED)
    run.go(3.0)
    run.state = run.state + np.array([0.3, -0.2, *np.zeros(7)])
    run.go(5.0)
    assert is_paper(run.estimate)
    run = Run(EXACT, UNDISTURBED)
    run.go(3.0)
    for slope in (SLOPE, -SLOPE):
        run.disturbance = Disturbance(slope)
        run.go(run.time + 3.5)
        assert run.momentum_error() < 0.1
        np.testing.assert_allclose(run.estimate.disturbance.slope, slope, atol=0.2)
