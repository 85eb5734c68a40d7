# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Roll-outs: derivatives, both solvers, invariants and order of convergence."""

import numpy as np
import pytest
from compiled_solver import compiled

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance, rest_speeds
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.solver import plain
from sphere_nmpc.solver.roll_out import Propagation, propagate, roll_out

CONSTANTS = RobotParameters().lumped.as_array()
MAX_STEP = 0.1  # s
ROUNDING = 1e-12
DIFFERENCE = 1e-6

PUSHED = np.array([30.0, -20.0, 15.0])
"""Momentum [rad/s] as after a push of about 1 N s."""
DISTURBANCE = Disturbance(np.array([20.0, -5.0]), np.array([3.0, 4.0, -8.0]))
"""A slope of about 1 degree and a centre of mass 2 mm off."""
WORLDS = (np.zeros(3), UNDISTURBED), (PUSHED, UNDISTURBED), (PUSHED, DISTURBANCE)
any_world = pytest.mark.parametrize(
    ("momentum", "disturbance"), WORLDS, ids=("paper", "pushed", "disturbed")
)


def hold(intervals, momentum):
    """Return a state, knots [rad/s] and interval lengths [s]."""
    assert compiled()
    rng = np.random.default_rng(3)
    q = rng.normal(size=4)
    state = np.concatenate((rng.uniform(-1.0, 1.0, 2), q / np.linalg.norm(q), momentum))
    inputs = rng.uniform(-100.0, 100.0, (intervals + 1, 2))
    return state, inputs, rng.uniform(0.05, 0.5, intervals)


@any_world
def test_derivatives_are_those_of_differences_and_of_the_plain_solver(momentum, disturbance):
    state, inputs, durations = hold(3, momentum)
    arguments = inputs, durations, CONSTANTS, MAX_STEP
    found, torques = propagate(state, *arguments, disturbance), disturbance.as_array()
    right_one = Propagation.of(*plain.propagate(state, torques, *arguments))
    for ours, right in zip(found, right_one, strict=True):
        np.testing.assert_allclose(ours, right, atol=1e-10)
    states = roll_out(state, *arguments, disturbance)
    right = plain.shoot(state, torques, *arguments).states
    assert states.shape == (4, 9)
    np.testing.assert_allclose(states[:, :6], right[:, :6], atol=ROUNDING)
    np.testing.assert_allclose(states[:, 6:], right[:, 6:], atol=100.0 * ROUNDING)

    def moved(part, change):
        """Return the error of the end where state, constants or torques are changed."""
        error, constants, other = (
            change if part == k else np.zeros(n) for k, n in enumerate((8, 4, 5))
        )
        changed = Disturbance.from_array(torques + other)
        start, p = apply_error(state, error), CONSTANTS + constants
        end = roll_out(start, inputs, durations, p, MAX_STEP, changed)[-1]
        return error_between(found.state, end)

    for part, derivative in enumerate(found[1:]):
        for column, change in zip(
            derivative.T, DIFFERENCE * np.eye(derivative.shape[1]), strict=True
        ):
            expected = (moved(part, change) - moved(part, -change)) / (2.0 * DIFFERENCE)
            np.testing.assert_allclose(column, expected, rtol=1e-6, atol=1e-6)


def test_rotors_that_hold_the_momentum_keep_the_sphere_at_rest():
    state, _, durations = hold(5, PUSHED)
    # Perpendicular to the body's z axis, which the rotors cannot hold.
    state[6:] = np.cross(rotation.matrix(state[2:6])[:, 2], PUSHED)
    inputs = np.tile(rest_speeds(state[6:], state[2:6]), (6, 1))
    states = roll_out(state, inputs, durations, CONSTANTS, MAX_STEP)
    assert np.allclose(states, state, atol=ROUNDING)


@any_world
def test_interval_of_no_length_changes_the_speeds_alone(momentum, disturbance):
    state, inputs, durations = hold(3, momentum)
    durations[1] = 0.0
    states = roll_out(state, inputs, durations, CONSTANTS, MAX_STEP, disturbance)
    assert np.allclose(states[2], states[1], atol=ROUNDING)
    after = roll_out(states[2], inputs[2:], durations[2:], CONSTANTS, MAX_STEP, disturbance)
    assert np.allclose(states[2:], after, atol=ROUNDING)


@any_world
def test_halving_the_step_gains_four_orders(momentum, disturbance):
    state, inputs, _ = hold(4, momentum)
    durations = np.full(4, 0.5)
    coarse, fine, truth = (
        roll_out(state, inputs, durations, CONSTANTS, 0.5 / steps, disturbance)
        for steps in (8, 16, 128)
    )
    # Order four: a factor of 16; between 8 and 32 no other order fits.
    for part in (slice(0, 6), slice(6, 9))[: 2 if disturbance is DISTURBANCE else 1]:
        errors = (np.max(np.abs(each - truth)[:, part]) for each in (coarse, fine))
        assert 8.0 < next(errors) / next(errors) < 32.0
