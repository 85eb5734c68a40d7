# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Error states on the plane and SO(3), and their propagation with and without momentum."""

from dataclasses import replace

import numpy as np
import pytest
from integration import integrate

from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.error_state import (
    apply_error,
    error_between,
    propagate,
    propagate_with_drift,
)
from sphere_nmpc.model.integrator import integrate_with_drift
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, angle_error, as_state

CONSTANTS = RobotParameters().lumped.as_array()
STATE = as_state([0.1, 0.2, 0.5, 0.5, -0.5, 0.5])
DRIFT = Drift(np.array([5.0, -3.0, 0.5]), np.array([2.0, 1.0]), np.array([0.5, -1.0, 2.0]))
DURATIONS = np.array([0.1, 0.15])
SPEEDS = np.array([[0.0, 0.0], [30.0, -40.0], [50.0, 20.0]])
DIFFERENCE = 1e-6


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
        for sign in (1.0, -1.0):  # both quaternions are one orientation
            other = np.concatenate((there[:2], sign * there[2:]))
            np.testing.assert_allclose(error_between(state, other), error, atol=1e-12)
        assert angle_error(state, there) == pytest.approx(np.linalg.norm(error[2:]), abs=1e-9)


def paper(start: Vector, drift: Vector, constants: Vector) -> tuple[Vector, list[Vector]]:
    """Return the end (6,) and its derivatives without momentum."""
    del drift
    end, *derivatives = propagate(start, (SPEEDS[1], SPEEDS[2]), 0.25, constants)
    return end, derivatives


def moving(start: Vector, drift: Vector, constants: Vector) -> tuple[Vector, list[Vector]]:
    """Return state and momentum at the end, shape (9,), and their derivatives."""
    end = propagate_with_drift(start, Drift.from_array(drift), DURATIONS, SPEEDS, constants)
    found = [end.by_start, end.by_constants, end.by_torques]
    return np.concatenate((end.state, end.momentum)), found


@pytest.mark.parametrize("model", [paper, moving])
def test_derivatives_are_those_of_differences(model) -> None:
    end, derivatives = model(STATE, DRIFT.as_array(), CONSTANTS)
    size = 5 if model is paper else 8

    def seen(error: Vector, constants: Vector, torques: Vector) -> Vector:
        drift = DRIFT.as_array() + np.concatenate((error[5:], torques))
        moved, _ = model(apply_error(STATE, error[:5]), drift, CONSTANTS + constants)
        found = np.concatenate((error_between(end[:6], moved[:6]), moved[6:] - end[6:]))
        return found[:size] / DIFFERENCE

    zeros = np.zeros(8), np.zeros(4), np.zeros(5)
    # Differences of first order: 1e-6 of the second derivatives, of up to 100 and 1000.
    for part, (derivative, tolerance) in enumerate(
        zip(derivatives, (1e-4, 1e-3, 1e-6), strict=False)
    ):
        for index in range(derivative.shape[1]):
            change = [zero.copy() for zero in zeros]
            change[part][index] = DIFFERENCE
            np.testing.assert_allclose(derivative[:, index], seen(*change), atol=tolerance)


def test_propagated_states_are_those_of_the_integrator() -> None:
    end, _, _ = propagate(STATE, (SPEEDS[1], SPEEDS[2]), 0.25, CONSTANTS)
    expected = integrate(STATE, SPEEDS[1], SPEEDS[2], 0.25, CONSTANTS)
    np.testing.assert_allclose(end, expected, atol=1e-14)
    found = propagate_with_drift(STATE, DRIFT, DURATIONS, SPEEDS, CONSTANTS)
    state, drift = STATE, DRIFT
    for duration, here, there in zip(DURATIONS, SPEEDS[:-1], SPEEDS[1:], strict=True):
        state, momentum = integrate_with_drift(state, drift, here, there, duration, CONSTANTS)
        drift = replace(drift, momentum=momentum)
    np.testing.assert_allclose(found.state, state, atol=1e-13)
    np.testing.assert_allclose(found.momentum, drift.momentum, atol=1e-12)
