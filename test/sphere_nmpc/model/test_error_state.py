# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Error states on the plane and SO(3), and their propagation."""

import numpy as np
import pytest

from sphere_nmpc.model.error_state import apply_error, error_between, propagate, state_rates
from sphere_nmpc.model.integrator import integrate
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, angle_error, as_state

CONSTANTS = RobotParameters().lumped.as_array()
DIFFERENCE = 1e-6
SPEEDS = (np.array([80.0, -30.0]), np.array([20.0, 90.0]))


def draw(rng: np.random.Generator) -> Vector:
    quaternion = rng.normal(size=4)
    return as_state([*rng.normal(size=2), *quaternion / np.linalg.norm(quaternion)])


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-9, 1e-3, 0.5, 3.0])
def test_error_between_a_state_and_the_changed_state_is_the_one_applied(size: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        state, error = draw(rng), rng.normal(size=5)
        error *= size / np.linalg.norm(error)
        there = apply_error(state, error)
        assert np.linalg.norm(there[2:]) == pytest.approx(1.0, abs=1e-14)
        np.testing.assert_allclose(error_between(state, there), error, atol=1e-12)
        assert angle_error(state, there) == pytest.approx(np.linalg.norm(error[2:]), abs=1e-9)


def test_both_signs_of_a_quaternion_have_the_same_error() -> None:
    rng = np.random.default_rng(2)
    state, other = draw(rng), draw(rng)
    flipped = np.concatenate((other[:2], -other[2:]))
    np.testing.assert_array_equal(
        error_between(state, other), error_between(state, flipped)
    )


def test_propagated_state_is_that_of_the_integrator() -> None:
    state = draw(np.random.default_rng(3))
    end, _, _ = propagate(state, SPEEDS, 0.25, CONSTANTS)
    np.testing.assert_allclose(end, integrate(state, *SPEEDS, 0.25, CONSTANTS), atol=1e-14)


def test_derivatives_are_those_of_differences() -> None:
    state = draw(np.random.default_rng(4))
    end, by_state, by_constants = propagate(state, SPEEDS, 0.25, CONSTANTS)
    for i in range(5):
        start = apply_error(state, DIFFERENCE * np.eye(5)[i])
        moved, _, _ = propagate(start, SPEEDS, 0.25, CONSTANTS)
        seen = error_between(end, moved) / DIFFERENCE
        np.testing.assert_allclose(by_state[:, i], seen, atol=1e-4)
    for i in range(4):
        moved, _, _ = propagate(state, SPEEDS, 0.25, CONSTANTS + DIFFERENCE * np.eye(4)[i])
        seen = error_between(end, moved) / DIFFERENCE
        np.testing.assert_allclose(by_constants[:, i], seen, atol=1e-3)


def test_rates_are_those_of_a_short_step() -> None:
    state = draw(np.random.default_rng(5))
    end = integrate(state, SPEEDS[0], SPEEDS[0], DIFFERENCE, CONSTANTS)
    seen = error_between(state, end) / DIFFERENCE
    np.testing.assert_allclose(state_rates(state, SPEEDS[0], CONSTANTS), seen, atol=1e-5)
