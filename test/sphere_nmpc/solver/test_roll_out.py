# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
import threading
from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.model import rotation
from sphere_nmpc.model.drift import NO_DRIFT, Drift
from sphere_nmpc.model.integrator import integrate_with_drift
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.solver import roll_out as module
from sphere_nmpc.solver.numpy_backend import horizon
from sphere_nmpc.solver.reference import shooting
from sphere_nmpc.solver.roll_out import (
    roll_out,
    roll_out_compiled,
    roll_out_with_momentum,
)

CONSTANTS = RobotParameters().lumped.as_array()
MAX_STEP = 0.1  # s
ROUNDING = 1e-12

DRIFT = Drift(np.array([30.0, -20.0, 15.0]), np.array([20.0, -5.0]), np.array([3.0, 4.0, -8.0]))
"""A push of about 1 N s, a slope of about 1 degree and a centre of mass 2 mm off."""
both = pytest.mark.parametrize("predict", (roll_out_compiled, horizon.roll_out))
any_drift = pytest.mark.parametrize("drift", (NO_DRIFT, DRIFT), ids=("level", "drift"))


def hold(intervals, seed=3, drift=NO_DRIFT):
    """Return a state, the drift, knots [rad/s] and interval lengths [s]."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=4)
    state = np.concatenate((rng.uniform(-1.0, 1.0, 2), q / np.linalg.norm(q)))
    inputs = rng.uniform(-100.0, 100.0, (intervals + 1, 2))
    return state, drift, inputs, rng.uniform(0.05, 0.5, intervals)


@both
def test_agrees_with_the_reference(make_problem, kind, predict):
    problem = make_problem(kind, whole_turns=0.0)
    inputs = np.random.default_rng(1).uniform(-100.0, 100.0, (problem.intervals + 1, 2))
    drift = Drift.from_array(problem.drift)
    found, momenta = predict(
        problem.state, drift, inputs, problem.durations, problem.constants, MAX_STEP
    )
    assert found.shape == (problem.intervals + 1, 6)
    assert momenta.shape == (problem.intervals + 1, 3)
    assert np.max(np.abs(found - shooting.roll_out(problem, inputs)[0])) < ROUNDING


@both
def test_states_and_momenta_are_those_of_the_integrator(predict):
    state, drift, inputs, durations = hold(4, drift=DRIFT)
    states, momenta = predict(state, drift, inputs, durations, CONSTANTS, MAX_STEP)
    x, momentum = state, drift.momentum
    assert np.array_equal(momenta[0], momentum)
    for m in range(4):
        x, momentum = integrate_with_drift(
            x, replace(drift, momentum=momentum), inputs[m], inputs[m + 1], durations[m],
            CONSTANTS, MAX_STEP,
        )
        assert np.allclose(states[m + 1], x, atol=ROUNDING)
        # Rounding of numbers of the order of 100 rad/s.
        assert np.allclose(momenta[m + 1], momentum, atol=100.0 * ROUNDING)


@both
def test_momentum_alone_is_kept(predict):
    pushed = Drift(DRIFT.momentum)
    state, _, inputs, durations = hold(5)
    states, momenta = predict(state, pushed, inputs, durations, CONSTANTS, MAX_STEP)
    assert np.all(momenta == pushed.momentum)
    without, zero = predict(state, NO_DRIFT, inputs, durations, CONSTANTS, MAX_STEP)
    assert np.max(np.abs(states - without)) > 0.1 and not zero.any()


@both
def test_rotors_that_hold_the_momentum_keep_the_sphere_at_rest(predict):
    state, _, _, durations = hold(5)
    # Perpendicular to the body's z axis, which the rotors cannot hold.
    z = rotation.matrix(state[2:])[:, 2]
    pushed = Drift(np.cross(z, [30.0, -20.0, 15.0]))
    inputs = np.tile(pushed.rest_speeds(state[2:]), (6, 1))
    states, _ = predict(state, pushed, inputs, durations, CONSTANTS, MAX_STEP)
    assert np.allclose(states, state, atol=ROUNDING)


@both
def test_drift_so_small_that_it_changes_nothing_gives_the_states_without(predict):
    """The two models are computed by different functions."""
    state, _, inputs, durations = hold(5)
    tiny = Drift(np.array([1e-14, 0.0, 0.0]))
    found, without = (
        predict(state, drift, inputs, durations, CONSTANTS, MAX_STEP)[0]
        for drift in (tiny, NO_DRIFT)
    )
    assert np.max(np.abs(found - without)) < ROUNDING


@both
@any_drift
def test_interval_of_no_length_changes_the_speeds_alone(predict, drift):
    state, _, inputs, durations = hold(3)
    durations[1] = 0.0
    states, momenta = predict(state, drift, inputs, durations, CONSTANTS, MAX_STEP)
    assert np.allclose(states[2], states[1], atol=ROUNDING)
    assert np.array_equal(momenta[2], momenta[1])
    later = replace(drift, momentum=momenta[2])
    after, _ = predict(states[2], later, inputs[2:], durations[2:], CONSTANTS, MAX_STEP)
    assert np.allclose(states[2:], after, atol=ROUNDING)


@both
@any_drift
def test_quaternion_keeps_its_norm_over_many_intervals(predict, drift):
    states, _ = predict(*hold(80, drift=drift), CONSTANTS, MAX_STEP)
    assert np.allclose(np.linalg.norm(states[:, 2:], axis=1), 1.0, atol=1e-13)


@both
@any_drift
def test_halving_the_step_gains_four_orders(predict, drift):
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


@both
@any_drift
def test_arguments_and_earlier_results_are_not_written_to(predict, drift):
    first = hold(4, 1, drift)
    given = [first[0].copy(), first[1].as_array(), first[2].copy(), first[3].copy()]
    found = predict(*first, CONSTANTS, MAX_STEP)
    kept = [array.copy() for array in found]
    predict(*hold(4, 2, drift), CONSTANTS, MAX_STEP)
    assert all(map(np.array_equal, found, kept))
    assert all(map(np.array_equal, (first[0], first[1].as_array(), *first[2:]), given))


@both
def test_several_threads_predict_at_the_same_time(predict):
    holds = [hold(n, n, drift) for n in (1, 4, 4, 9) * 2 for drift in (NO_DRIFT, DRIFT)]
    expected = [predict(*each, CONSTANTS, MAX_STEP) for each in holds]
    together = [None] * len(holds)

    def work(i):
        for _ in range(50):
            together[i] = predict(*holds[i], CONSTANTS, MAX_STEP)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(len(holds))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for found, right in zip(together, expected, strict=True):
        assert all(map(np.array_equal, found, right))


@pytest.mark.parametrize(
    ("backend", "expected"), [("compiled", roll_out_compiled), ("numpy", horizon.roll_out)]
)
def test_back_end_is_the_one_of_this_machine(monkeypatch, backend, expected):
    monkeypatch.setattr(module, "resolve_backend", lambda _: backend)
    module._chosen.cache_clear()
    try:
        state, drift, *rest = hold(5, drift=DRIFT)
        states, momenta = roll_out_with_momentum(state, drift, *rest, CONSTANTS)
        right = expected(state, drift, *rest, CONSTANTS, MAX_STEP)
        assert np.array_equal(states, right[0]) and np.array_equal(momenta, right[1])
        assert np.array_equal(roll_out(state, *rest, CONSTANTS, drift=drift), states)
        without = expected(state, NO_DRIFT, *rest, CONSTANTS, MAX_STEP)[0]
        assert np.array_equal(roll_out(state, *rest, CONSTANTS), without)
        assert module._chosen() is expected
    finally:
        module._chosen.cache_clear()
