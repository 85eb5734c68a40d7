# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest
from compiled_solver import compiled

from sphere_nmpc.model import rotation
from sphere_nmpc.model.drift import NO_DRIFT, Drift
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.solver.plain import shoot
from sphere_nmpc.solver.roll_out import roll_out, roll_out_with_momentum

CONSTANTS = RobotParameters().lumped.as_array()
MAX_STEP = 0.1  # s
ROUNDING = 1e-12

DRIFT = Drift(np.array([30.0, -20.0, 15.0]), np.array([20.0, -5.0]), np.array([3.0, 4.0, -8.0]))
"""A push of about 1 N s, a slope of about 1 degree and a centre of mass 2 mm off."""
any_drift = pytest.mark.parametrize("drift", (NO_DRIFT, DRIFT), ids=("level", "drift"))


def predict(*arguments):
    assert compiled()
    return roll_out_with_momentum(*arguments)


def hold(intervals, seed=3, drift=NO_DRIFT):
    """Return a state, the drift, knots [rad/s] and interval lengths [s]."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=4)
    state = np.concatenate((rng.uniform(-1.0, 1.0, 2), q / np.linalg.norm(q)))
    inputs = rng.uniform(-100.0, 100.0, (intervals + 1, 2))
    return state, drift, inputs, rng.uniform(0.05, 0.5, intervals)


@any_drift
def test_agrees_with_the_plain_solver(drift):
    state, _, inputs, durations = hold(5)
    states, momenta = predict(state, drift, inputs, durations, CONSTANTS, MAX_STEP)
    right = shoot(state, drift.as_array(), inputs, durations, CONSTANTS, MAX_STEP)
    assert states.shape == (6, 6) and momenta.shape == (6, 3)
    assert np.max(np.abs(states - right.states)) < ROUNDING
    assert np.max(np.abs(momenta - right.momenta)) < 100.0 * ROUNDING
    assert np.array_equal(roll_out(state, inputs, durations, CONSTANTS, MAX_STEP, drift), states)


def test_rotors_that_hold_the_momentum_keep_the_sphere_at_rest():
    state, _, _, durations = hold(5)
    # Perpendicular to the body's z axis, which the rotors cannot hold.
    z = rotation.matrix(state[2:])[:, 2]
    pushed = Drift(np.cross(z, [30.0, -20.0, 15.0]))
    inputs = np.tile(pushed.rest_speeds(state[2:]), (6, 1))
    states, _ = predict(state, pushed, inputs, durations, CONSTANTS, MAX_STEP)
    assert np.allclose(states, state, atol=ROUNDING)


@any_drift
def test_interval_of_no_length_changes_the_speeds_alone(drift):
    state, _, inputs, durations = hold(3)
    durations[1] = 0.0
    states, momenta = predict(state, drift, inputs, durations, CONSTANTS, MAX_STEP)
    assert np.allclose(states[2], states[1], atol=ROUNDING)
    assert np.array_equal(momenta[2], momenta[1])
    later = replace(drift, momentum=momenta[2])
    after, _ = predict(states[2], later, inputs[2:], durations[2:], CONSTANTS, MAX_STEP)
    assert np.allclose(states[2:], after, atol=ROUNDING)


@any_drift
def test_halving_the_step_gains_four_orders(drift):
    state, _, inputs, _ = hold(4)
    durations = np.full(4, 0.5)
    coarse, fine, truth = (
        np.hstack(predict(state, drift, inputs, durations, CONSTANTS, 0.5 / steps))
        for steps in (8, 16, 128)
    )
    # Order four: a factor of 16; between 8 and 32 no other order fits.
    for part in (slice(0, 6), slice(6, 9))[: 1 if drift is NO_DRIFT else 2]:
        errors = (np.max(np.abs(each - truth)[:, part]) for each in (coarse, fine))
        assert 8.0 < next(errors) / next(errors) < 32.0
