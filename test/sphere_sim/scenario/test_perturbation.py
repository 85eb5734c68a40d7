# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random errors of the robot's parameters."""

from dataclasses import asdict

import numpy as np
import pytest

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.scenario.perturbation import LIMITS, perturbed

ROBOT = RobotParameters()


def draw(fraction: float, seed: int) -> dict[str, float]:
    return asdict(perturbed(ROBOT, fraction, np.random.default_rng(seed)))


def test_no_perturbation_is_the_same_robot() -> None:
    assert perturbed(ROBOT, 0.0, np.random.default_rng(0)) is ROBOT


def test_same_seed_same_robot_another_seed_another_one() -> None:
    assert draw(0.1, 1) == draw(0.1, 1) != draw(0.1, 2)


def test_every_physical_parameter_varies_within_its_range_and_limits_stay() -> None:
    robots = [draw(0.2, seed) for seed in range(300)]
    for name, nominal in asdict(ROBOT).items():
        drawn = np.array([robot[name] for robot in robots])
        if name in LIMITS:
            assert np.all(drawn == nominal)
        else:
            ratios = drawn / nominal
            assert np.all(np.abs(ratios - 1.0) <= 0.2 + 1e-12)
            assert ratios.min() < 0.85 and ratios.max() > 1.15


@pytest.mark.parametrize("fraction", [-0.1, 1.0, float("nan")])
def test_fraction_out_of_range_is_refused(fraction) -> None:
    with pytest.raises(InvalidParameterError):
        perturbed(ROBOT, fraction, np.random.default_rng(0))
