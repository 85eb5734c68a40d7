# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Propagation of the error of state and momentum."""

import threading

import numpy as np
import pytest

from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.drift_propagation import (
    DriftPropagation,
    propagate_with_drift,
    state_rates_with_drift,
)
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.integrator import integrate_with_drift
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, as_state

CONSTANTS = RobotParameters().lumped.as_array()
STATE = as_state([0.1, 0.2, 0.5, 0.5, -0.5, 0.5])
DRIFT = Drift(np.array([5.0, -3.0, 0.5]), np.array([2.0, 1.0]), np.array([0.5, -1.0, 2.0]))
DURATIONS = np.array([0.1, 0.15])
SPEEDS = np.array([[0.0, 0.0], [30.0, -40.0], [50.0, 20.0]])
DIFFERENCE = 1e-6


def propagated(
    error: Vector | None = None, constants: Vector = CONSTANTS, torques: Vector | None = None
) -> DriftPropagation:
    error = np.zeros(8) if error is None else error
    values = DRIFT.as_array() + np.concatenate((error[5:], np.zeros(5)))
    values[3:] += 0.0 if torques is None else torques
    start = apply_error(STATE, error[:5])
    return propagate_with_drift(start, Drift.from_array(values), DURATIONS, SPEEDS, constants)


def away(moved: DriftPropagation) -> Vector:
    end = propagated()
    error = error_between(end.state, moved.state)
    return np.concatenate((error, moved.momentum - end.momentum)) / DIFFERENCE


def test_state_and_momentum_are_those_of_the_integrator() -> None:
    end = propagated()
    state, drift = STATE, DRIFT
    for duration, here, there in zip(DURATIONS, SPEEDS[:-1], SPEEDS[1:], strict=True):
        state, momentum = integrate_with_drift(state, drift, here, there, duration, CONSTANTS)
        drift = Drift(momentum, DRIFT.slope, DRIFT.imbalance)
    np.testing.assert_allclose(end.state, state, atol=1e-13)
    np.testing.assert_allclose(end.momentum, drift.momentum, atol=1e-12)


@pytest.mark.parametrize("index", range(8))
def test_derivatives_by_the_start_are_those_of_differences(index: int) -> None:
    seen = away(propagated(error=DIFFERENCE * np.eye(8)[index]))
    # Differences of first order with this step: 1e-6 of the second derivatives, below 100.
    np.testing.assert_allclose(propagated().by_start[:, index], seen, atol=1e-4)


@pytest.mark.parametrize("index", range(4))
def test_derivatives_by_the_constants_are_those_of_differences(index: int) -> None:
    seen = away(propagated(constants=CONSTANTS + DIFFERENCE * np.eye(4)[index]))
    np.testing.assert_allclose(propagated().by_constants[:, index], seen, atol=1e-3)


@pytest.mark.parametrize("index", range(5))
def test_derivatives_by_the_torques_are_those_of_differences(index: int) -> None:
    seen = away(propagated(torques=DIFFERENCE * np.eye(5)[index]))
    np.testing.assert_allclose(propagated().by_torques[:, index], seen, atol=1e-6)


def test_rates_are_those_of_a_short_step() -> None:
    end, _ = integrate_with_drift(STATE, DRIFT, SPEEDS[1], SPEEDS[1], DIFFERENCE, CONSTANTS)
    seen = error_between(STATE, end) / DIFFERENCE
    found = state_rates_with_drift(STATE, DRIFT, SPEEDS[1], CONSTANTS)
    np.testing.assert_allclose(found, seen, atol=1e-5)


def test_several_threads_may_propagate_at_once() -> None:
    wrong: list[int] = []
    expected = propagated()

    def repeat(seed: int) -> None:
        torques = np.random.default_rng(seed).normal(size=5)
        own = propagated(torques=torques)
        for _ in range(50):
            if not np.array_equal(propagated(torques=torques).by_start, own.by_start):
                wrong.append(seed)

    threads = [threading.Thread(target=repeat, args=(seed,)) for seed in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    np.testing.assert_array_equal(propagated().by_start, expected.by_start)
