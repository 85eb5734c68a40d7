# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plant constants and noise estimated from the motion of an independently written plant."""

import dataclasses

import numpy as np
import pytest

from sphere_nmpc.estimation.plant_estimator import PlantEstimator
from sphere_nmpc.estimation.transition import Transition
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.world.plant.rolling_plant import RollingPlant

NOMINAL = RobotParameters()
PERIOD = 0.25
LIMIT = 400.0
"""Limit of the speeds that are sent [rad/s^2]."""


def drive(
    estimator: PlantEstimator, robot: RobotParameters, samples: int, seed: int, noise: float = 0.0
) -> None:
    """Roll a plant with random ramps and pass each transition to the estimator."""
    rng = np.random.default_rng(seed)
    plant = RollingPlant(robot, np.array([0, 0, 1.0, 0, 0, 0]))
    speeds: Vector = np.zeros(2)
    for _ in range(samples):
        before, after = plant.state, rng.uniform(-100.0, 100.0, 2)
        plant.advance(after, PERIOD)
        seen = plant.state + noise * rng.normal(size=6)
        seen[2:] /= np.linalg.norm(seen[2:])
        plant.displace(seen)
        pieces = np.array([PERIOD]), np.vstack((speeds, after))
        estimator.observe(Transition(before, seen, *pieces))
        speeds = after


def relative_error(estimator: PlantEstimator, robot: RobotParameters) -> float:
    found = estimator.estimate.constants.as_array()
    return float(np.max(np.abs(found / robot.lumped.as_array() - 1.0)))


def deviations(estimator: PlantEstimator) -> Vector:
    found = estimator.estimate.deviations
    assert found is not None
    return found


@pytest.mark.parametrize("percent", [3, 20])
def test_wrong_parameters_are_corrected_within_a_second(percent: int) -> None:
    for seed in range(2):
        robot = perturbed(NOMINAL, percent / 100.0, np.random.default_rng(seed))
        estimator = PlantEstimator(NOMINAL.lumped)
        drive(estimator, robot, 4, seed)
        # The prediction's own error over a sample is 1e-5 of about 0.1 m; four samples of one path
        # tell the two ratios apart ten times worse than that.
        assert relative_error(estimator, robot) < 3e-3


def test_noise_is_distinguished_from_wrong_constants() -> None:
    robot = perturbed(NOMINAL, 0.03, np.random.default_rng(3))
    estimator = PlantEstimator(NOMINAL.lumped)
    drive(estimator, robot, 40, 3, noise=1e-3)
    # 20 residuals of 5 components: the deviation of a deviation is 7 %; four of these.
    assert estimator.estimate.noise == pytest.approx(1e-3, rel=0.3)
    errors = estimator.estimate.constants.as_array() - robot.lumped.as_array()
    assert np.all(np.abs(errors) < 4.0 * deviations(estimator))


def drive_weakly(
    estimator: PlantEstimator, robot: RobotParameters, share: float, moved: float = 0.0
) -> None:
    """Send ramps at the limit, with pauses between, to rotors that attain a share of it.

    The robot is moved by `moved` [m] in each direction during the fifth sample.
    """
    rng = np.random.default_rng(4)
    plant = RollingPlant(robot, np.array([0, 0, 1.0, 0, 0, 0]))
    sent: list[Vector] = [np.zeros(2)] * 5
    for i in range(8):
        before, reach = plant.state, LIMIT * PERIOD
        wanted = sent[-1] if i % 3 == 2 else sent[-1] + rng.choice([-reach, reach], 2)
        sent.append(np.clip(wanted, -100.0, 100.0))
        durations, inputs = np.full(5, PERIOD), np.array(sent[-6:])
        raw = Transition(before, before, durations, inputs, lead=4.0 * PERIOD)
        pieces = raw.driven(share * LIMIT, 0.0)
        for duration, speeds in zip(pieces.durations, pieces.inputs[1:], strict=True):
            plant.advance(speeds, float(duration))
        if i == 4:
            plant.displace(plant.state + np.array([moved, moved, 0, 0, 0, 0]))
        estimator.observe(dataclasses.replace(raw, end=plant.state))


@pytest.mark.parametrize("share", [0.6, 0.93, 1.0])
def test_drives_that_attain_less_acceleration_are_told_from_wrong_constants(share: float) -> None:
    robot = perturbed(NOMINAL, 0.2, np.random.default_rng(1))
    estimator = PlantEstimator(NOMINAL.lumped, acceleration=LIMIT)
    drive_weakly(estimator, robot, share)
    attained = share * LIMIT if share < 1.0 else np.inf
    assert estimator.estimate.acceleration == pytest.approx(attained, rel=0.01)
    assert estimator.estimate.lag < 5e-4
    # As in the test above without weak drives.
    assert relative_error(estimator, robot) < 3e-3


@pytest.mark.parametrize("share", [0.8, 1.0])
def test_robot_that_is_pushed_does_not_count_as_one_with_weaker_drives(share: float) -> None:
    estimator = PlantEstimator(NOMINAL.lumped, acceleration=LIMIT)
    drive_weakly(estimator, NOMINAL, share, moved=-0.02)
    assert estimator.share == pytest.approx(share, rel=0.01)


def test_constants_far_from_the_prior_do_not_pass_for_noise() -> None:
    # Five standard deviations from the prior; the largest that 20 % in all parameters give.
    axial = 1.55 * NOMINAL.rotor_axial_inertia
    robot = dataclasses.replace(NOMINAL, rotor_axial_inertia=axial)
    estimator = PlantEstimator(NOMINAL.lumped)
    drive(estimator, robot, 4, 0)
    assert relative_error(estimator, robot) < 3e-3
    assert estimator.estimate.noise < 1e-4
