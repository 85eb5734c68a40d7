# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Momentum, slope and imbalance from exact transitions of a plant with wrong constants.

A transition is exact to 1e-5, and a momentum of 1 rad/s moves the sphere by 5e-3 in it: it is seen
to about 2e-3 rad/s, and a slope within a second to 1e-2 rad/s^2. Tolerances are five to ten times
that.
"""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.estimation.drift_equations import NormalEquations
from sphere_nmpc.estimation.drifting_plant import DriftingPlantEstimator
from sphere_nmpc.estimation.plant_estimator import PlantEstimator
from sphere_nmpc.estimation.plant_parameters import ParameterDistribution
from sphere_nmpc.estimation.transition import Transition
from sphere_nmpc.model.drift import (
    NO_DRIFT,
    Drift,
    imbalance_of_offset,
    momentum_of_push,
    slope_torque,
)
from sphere_nmpc.model.integrator import integrate_with_drift
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, as_state
from sphere_sim.scenario.perturbation import perturbed

NOMINAL = RobotParameters()
PERIOD = 0.25
MOMENTUM_TOLERANCE = 0.02
SLOPE_TOLERANCE = 0.1
SLOPE = slope_torque(NOMINAL, np.radians(0.1), 0.7)
IMBALANCE = imbalance_of_offset(NOMINAL, np.array([3e-4, -4e-4, 5e-4]))
PUSH = momentum_of_push(NOMINAL, np.array([0.4, 0.3]))


class Robot:
    """A robot with drift, and the estimator that watches it."""

    def __init__(
        self, percent: float = 3.0, drift: Drift = NO_DRIFT, noise: float = 0.0, seed: int = 1
    ) -> None:
        self.rng = np.random.default_rng(seed)
        robot = perturbed(NOMINAL, percent / 100.0, np.random.default_rng(seed + 100))
        self.constants = robot.lumped.as_array()
        self.state = as_state([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        self.drift, self.noise = drift, noise
        self.speeds: Vector = np.zeros(2)
        self.time = 0.0
        mean = ParameterDistribution.prior(0.0).mean
        self.estimator = DriftingPlantEstimator(NOMINAL.lumped, mean, True)
        self.paper = PlantEstimator(NOMINAL.lumped, mean)

    def roll(self, transitions: int, push: Vector | None = None, share: float = 0.4) -> None:
        """Follow random ramps; a push comes after a share of the first transition."""
        for _ in range(transitions):
            self.move(self.rng.uniform(-60.0, 60.0, 2), push, share)
            push = None

    def rest(self, transitions: int) -> None:
        """Hold the momentum with the rotors."""
        for _ in range(transitions):
            quaternion = self.state[2:]
            after = self.drift.after_rest(quaternion, PERIOD)
            self.move(after.rest_speeds(quaternion))

    def move(self, speeds: Vector, push: Vector | None = None, share: float = 1.0) -> None:
        start, end, since = self.state, self.state, self.speeds
        middle = since + share * (speeds - since)
        for here, there, part in ((since, middle, share), (middle, speeds, 1.0 - share)):
            if part > 0.0:
                end, momentum = integrate_with_drift(
                    end, self.drift, here, there, part * PERIOD, self.constants, 0.01
                )
                self.drift = replace(self.drift, momentum=momentum)
            if push is not None:
                self.drift = replace(self.drift, momentum=self.drift.momentum + push)
                push = None
        if self.noise:
            end = end + self.noise * self.rng.normal(size=6)
            end[2:] /= np.linalg.norm(end[2:])
        self.show(start, end, np.vstack((since, speeds)))
        self.state, self.speeds = end, speeds

    def show(self, start: Vector, end: Vector, inputs: Vector) -> None:
        connected, self.time = self.time > 0.0, self.time + PERIOD
        transition = Transition(start, end, np.array([PERIOD]), inputs)
        self.paper.observe(transition)
        self.estimator.observe(transition, self.time, connected)

    @property
    def found(self) -> Drift:
        return self.estimator.result.drift

    def momentum_error(self) -> float:
        return float(np.linalg.norm(self.found.momentum - self.drift.momentum))


@pytest.mark.parametrize(("percent", "noise"), [(0.0, 0.0), (10.0, 0.0), (3.0, 1e-3)])
def test_nothing_is_invented_on_a_level_floor(percent: float, noise: float) -> None:
    for seed in range(2):
        robot = Robot(percent, noise=noise, seed=seed)
        for _ in range(16):
            robot.roll(1)
            assert robot.found is NO_DRIFT
        robot.move(np.zeros(2))
        robot.rest(10)
        assert robot.found is NO_DRIFT
        plant = robot.estimator.result.plant
        assert plant.constants == robot.paper.estimate.constants, "equal to the bit"
        assert plant.noise == robot.paper.estimate.noise


@pytest.mark.parametrize("percent", [3.0, 10.0])
@pytest.mark.parametrize(
    "drift", [Drift(slope=SLOPE), Drift(PUSH, SLOPE, IMBALANCE)], ids=["slope", "all"]
)
def test_momentum_slope_and_imbalance_are_found_in_motion(percent: float, drift: Drift) -> None:
    robot = Robot(percent, drift)
    robot.roll(16)
    assert robot.momentum_error() < MOMENTUM_TOLERANCE
    np.testing.assert_allclose(robot.found.slope, SLOPE, atol=SLOPE_TOLERANCE)
    np.testing.assert_allclose(robot.found.imbalance, drift.imbalance, atol=SLOPE_TOLERANCE)


def test_long_rest_on_a_slope_loses_nothing() -> None:
    robot = Robot(3.0, Drift(slope=0.05 * SLOPE))
    robot.roll(12)
    before = robot.estimator.result
    robot.rest(60)
    after = robot.estimator.result
    assert robot.momentum_error() < MOMENTUM_TOLERANCE
    for result in (before, after):
        constants = result.plant.constants.as_array()
        np.testing.assert_allclose(constants, robot.constants, rtol=2e-3)
    # Another lag keeps the drift.
    changed = robot.estimator.restarted(0.01).result
    np.testing.assert_allclose(changed.drift.as_array(), after.drift.as_array(), atol=1e-6)
    assert changed.plant.lag == pytest.approx(0.01)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_push_is_recognised_within_two_samples(share: float) -> None:
    for seed in range(2):
        robot = Robot(3.0, seed=seed)
        robot.roll(8)
        assert robot.found is NO_DRIFT
        robot.roll(2, PUSH, share)
        assert robot.momentum_error() < 0.02 * np.linalg.norm(PUSH)
        assert robot.estimator.result.plant.noise < 1e-4
        robot.roll(6)
        assert robot.momentum_error() < MOMENTUM_TOLERANCE
    robot.roll(2, -2.0 * PUSH)
    assert robot.momentum_error() < 0.02 * np.linalg.norm(PUSH)
    robot.roll(4, PUSH)
    robot.roll(14)
    assert np.linalg.norm(robot.found.momentum) < MOMENTUM_TOLERANCE, "drift that is gone"


def test_robot_that_was_carried_is_no_push() -> None:
    robot = Robot(3.0)
    robot.roll(8)
    carried = robot.state + np.array([0.3, -0.2, 0.0, 0.0, 0.0, 0.0])
    robot.show(robot.state, carried, np.vstack((robot.speeds, robot.speeds)))
    robot.state = carried
    assert robot.found is NO_DRIFT
    robot.roll(4)
    assert robot.found is NO_DRIFT


def test_update_that_fails_does_not_break_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Robot(3.0, Drift(slope=SLOPE))
    robot.roll(10)

    def fail(self: NormalEquations) -> Vector:
        raise np.linalg.LinAlgError("singular")

    with monkeypatch.context() as patch:
        patch.setattr(NormalEquations, "step", fail)
        with pytest.raises(np.linalg.LinAlgError):
            robot.roll(1)
    robot.roll(8)
    np.testing.assert_allclose(robot.found.slope, SLOPE, atol=SLOPE_TOLERANCE)


def test_floor_that_tilts_under_a_resting_sphere_is_noticed_within_three_samples() -> None:
    robot = Robot(3.0)
    robot.roll(12)
    robot.move(np.zeros(2))
    robot.rest(8)
    for slope in (2.0 * SLOPE, np.zeros(2)):
        robot.drift = replace(robot.drift, slope=slope)
        for _ in range(3):
            robot.move(robot.found.rest_speeds(robot.state[2:]))
        assert robot.momentum_error() < MOMENTUM_TOLERANCE
        # At rest slope and imbalance have the same effect; their sum is what is measured.
        torque = robot.found.torque_at_rest(robot.state[2:])
        np.testing.assert_allclose(torque[:2], slope, atol=SLOPE_TOLERANCE)
