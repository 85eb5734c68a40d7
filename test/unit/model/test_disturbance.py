# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Units of momentum and disturbance, and the time until a rotor at rest is at its limit."""

import math

import numpy as np
import pytest

from sphere_nmpc.model.disturbance import (
    UNDISTURBED,
    Disturbance,
    angle_of_slope,
    imbalance_of_offset,
    momentum_of_push,
    offset_of_imbalance,
    push_against,
    slope_torque,
    time_to_saturation,
)
from sphere_nmpc.model.parameters import RobotParameters

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
ON_SIDE = np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])
"""Body z level and along -y."""
ROBOT = RobotParameters()
SLOPE = Disturbance(np.array([0.0, 10.0]))
OPPOSITE = Disturbance(np.array([0.0, -10.0]))


def test_units_of_a_robot_and_their_inverses_agree_with_hand_calculation() -> None:
    push = momentum_of_push(ROBOT, np.array([0.5, -0.2]))
    np.testing.assert_allclose(push, [0.2 * 0.3 / 0.008, 0.5 * 0.3 / 0.008, 0.0])
    np.testing.assert_allclose(push_against(ROBOT, push), [-0.5, 0.2])
    slope = slope_torque(ROBOT, 0.02, 0.7)
    assert np.linalg.norm(slope) == pytest.approx(3.8 * 9.81 * math.sin(0.02) * 0.3 / 0.008)
    assert slope @ [math.cos(0.7), math.sin(0.7)] == pytest.approx(0.0, abs=1e-12)
    assert angle_of_slope(ROBOT, slope) == pytest.approx(0.02)
    offset = np.array([1e-3, -2e-3, 3e-3])
    imbalance = imbalance_of_offset(ROBOT, offset)
    np.testing.assert_allclose(imbalance, 3.8 * 9.81 / 0.008 * offset)
    np.testing.assert_allclose(offset_of_imbalance(ROBOT, imbalance), offset)


@pytest.mark.parametrize(
    ("momentum", "disturbance", "quaternion", "expected"),
    [
        ([0.0, 0.0, 0.0], UNDISTURBED, UPRIGHT, math.inf),
        ([50.0, 0.0, 0.0], UNDISTURBED, UPRIGHT, math.inf),
        # At its limit or beyond, even where the torque takes from it.
        ([0.0, 100.0, 0.0], OPPOSITE, UPRIGHT, 0.0),
        ([0.0, -130.0, 0.0], SLOPE, UPRIGHT, 0.0),
        ([0.0, -50.0, 0.0], SLOPE, UPRIGHT, 15.0),
        ([0.0, 50.0, 0.0], SLOPE, UPRIGHT, 5.0),
        ([0.0, 0.0, 0.0], Disturbance(np.array([10.0, 0.0])), ON_SIDE, 10.0),
    ],
)
def test_time_to_saturation_agrees_with_hand_calculation(
    momentum, disturbance, quaternion, expected
) -> None:
    found = time_to_saturation(np.array(momentum), disturbance, quaternion, 100.0)
    assert found == pytest.approx(expected, rel=1e-12)
