# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time until a rotor of a resting sphere is at its limit."""

import math

import numpy as np
import pytest

from sphere_nmpc.model import rotation
from sphere_nmpc.model.drift import NO_DRIFT, Drift, slope_torque
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.saturation import time_to_saturation

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
ROBOT = RobotParameters()


def test_there_is_no_saturation_without_drift_or_with_momentum_alone() -> None:
    assert time_to_saturation(NO_DRIFT, UPRIGHT, 100.0) == math.inf
    assert time_to_saturation(Drift(momentum=np.array([50.0, 0, 0])), UPRIGHT, 100.0) == math.inf


def test_a_rotor_at_its_limit_or_beyond_is_saturated_at_once() -> None:
    for speed in (100.0, -100.0, 130.0):
        drift = Drift(momentum=np.array([0.0, speed, 0.0]), slope=np.array([0.0, -np.sign(speed)]))
        assert time_to_saturation(drift, UPRIGHT, 100.0) == 0.0


def test_a_slope_of_a_degree_fills_a_rotor_in_four_seconds() -> None:
    """24.4 rad/s per second: 4.1 s from rest, as measured in the plant with contact."""
    drift = Drift(slope=slope_torque(ROBOT, math.radians(1.0), 0.0))
    assert time_to_saturation(drift, UPRIGHT, 100.0) == pytest.approx(4.1, abs=0.05)


def test_momentum_against_the_torque_lengthens_the_rest() -> None:
    torque = np.array([0.0, 10.0])
    opposed = Drift(momentum=np.array([0.0, -50.0, 0.0]), slope=torque)
    along = Drift(momentum=np.array([0.0, 50.0, 0.0]), slope=torque)
    assert time_to_saturation(opposed, UPRIGHT, 100.0) == pytest.approx(15.0, rel=1e-12)
    assert time_to_saturation(along, UPRIGHT, 100.0) == pytest.approx(5.0, rel=1e-12)


def test_a_rotor_is_at_its_limit_at_that_time_and_none_before() -> None:
    """Against the drift after a rest of this duration; tolerance: rounding."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        quaternion = rng.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        drift = Drift(*(rng.normal(size=n) * size for n, size in ((3, 30), (2, 5), (3, 5))))
        time = time_to_saturation(drift, quaternion, 150.0)
        for part, compare in ((1.0, np.isclose), (0.99, np.less), (0.5, np.less)):
            speeds = drift.after_rest(quaternion, part * time).rest_speeds(quaternion)
            assert compare(np.abs(speeds).max(), 150.0)


def test_a_rotor_that_the_torque_does_not_turn_is_never_filled() -> None:
    """On its side, with body z level and along the torque, both rotors are free of it."""
    on_side = np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])
    assert rotation.matrix(on_side)[:, 2] == pytest.approx([0.0, -1.0, 0.0])
    along, across = (Drift(slope=np.array(slope)) for slope in ([0.0, 1.0], [1.0, 0.0]))
    assert time_to_saturation(along, on_side, 100.0) > 1e9  # inf but for rounding
    assert time_to_saturation(across, on_side, 100.0) == pytest.approx(100.0)
