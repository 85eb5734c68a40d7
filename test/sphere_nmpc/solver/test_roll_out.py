# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
import threading

import numpy as np
import pytest

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.solver import roll_out as module
from sphere_nmpc.solver.numpy_backend import horizon
from sphere_nmpc.solver.reference import shooting
from sphere_nmpc.solver.roll_out import roll_out, roll_out_compiled

CONSTANTS = RobotParameters().lumped.as_array()
MAX_STEP = 0.1  # s
ROUNDING = 1e-12

both = pytest.mark.parametrize("predict", (roll_out_compiled, horizon.roll_out))


def hold(intervals, seed=3):
    """Return a state, knots [rad/s] and interval lengths [s]."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=4)
    state = np.concatenate((rng.uniform(-1.0, 1.0, 2), q / np.linalg.norm(q)))
    inputs = rng.uniform(-100.0, 100.0, (intervals + 1, 2))
    return state, inputs, rng.uniform(0.05, 0.5, intervals)


@both
def test_agrees_with_the_reference(make_problem, kind, predict):
    problem = make_problem(kind)
    inputs = np.random.default_rng(1).uniform(-100.0, 100.0, (problem.intervals + 1, 2))
    found = predict(problem.state, inputs, problem.durations, problem.constants, MAX_STEP)
    assert found.shape == (problem.intervals + 1, 6)
    assert np.max(np.abs(found - shooting.roll_out(problem, inputs))) < ROUNDING


@both
def test_interval_of_no_length_changes_the_speeds_alone(predict):
    state, inputs, durations = hold(3)
    durations[1] = 0.0
    found = predict(state, inputs, durations, CONSTANTS, MAX_STEP)
    assert np.allclose(found[2], found[1], atol=ROUNDING)
    after = predict(found[2], inputs[2:], durations[2:], CONSTANTS, MAX_STEP)
    assert np.allclose(found[2:], after, atol=ROUNDING)


@both
def test_quaternion_keeps_its_norm_over_many_intervals(predict):
    states = predict(*hold(80), CONSTANTS, MAX_STEP)
    assert np.allclose(np.linalg.norm(states[:, 2:], axis=1), 1.0, atol=1e-13)


@both
def test_halving_the_step_gains_four_orders(predict):
    state, inputs, _ = hold(4)
    durations = np.full(4, 0.5)
    coarse, fine, truth = (
        predict(state, inputs, durations, CONSTANTS, 0.5 / steps) for steps in (8, 16, 128)
    )
    # Order four: a factor of 16; between 8 and 32 no other order fits.
    assert 8.0 < np.max(np.abs(coarse - truth)) / np.max(np.abs(fine - truth)) < 32.0


@both
def test_arguments_and_earlier_results_are_not_written_to(predict):
    first = hold(4, 1)
    given = [array.copy() for array in first]
    found = predict(*first, CONSTANTS, MAX_STEP)
    kept = found.copy()
    predict(*hold(4, 2), CONSTANTS, MAX_STEP)
    assert np.array_equal(found, kept)
    assert all(map(np.array_equal, first, given))


@both
def test_several_threads_predict_at_the_same_time(predict):
    holds = [hold(n, n) for n in (1, 4, 4, 9) * 3]
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
    assert all(map(np.array_equal, together, expected))


@pytest.mark.parametrize(
    ("backend", "expected"), [("compiled", roll_out_compiled), ("numpy", horizon.roll_out)]
)
def test_back_end_is_the_one_of_this_machine(monkeypatch, backend, expected):
    monkeypatch.setattr(module, "resolve_backend", lambda _: backend)
    module._chosen.cache_clear()
    try:
        assert np.array_equal(
            roll_out(*hold(5), CONSTANTS), expected(*hold(5), CONSTANTS, MAX_STEP)
        )
        assert module._chosen() is expected
    finally:
        module._chosen.cache_clear()
