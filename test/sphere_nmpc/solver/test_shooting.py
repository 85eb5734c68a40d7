# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from sphere_nmpc.solver.hold_solver import expand_compiled
from sphere_nmpc.solver.reference.objective import cost, expand
from sphere_nmpc.solver.reference.shooting import roll_out, roll_out_with_sensitivity

STEP = 1e-6  # of a scaled input; a central difference is then good to about 1e-9
DIFFERENCE_TOLERANCE = 1e-7
ROUNDING = 1e-12


@pytest.fixture
def point(make_problem, kind):
    problem = make_problem(kind)
    return problem, np.random.default_rng(1).uniform(-90.0, 90.0, (problem.intervals, 2))


def test_sensitivities_agree_with_finite_differences(point):
    problem, knots = point
    inputs = np.vstack((problem.input_in_force, knots))
    _, sensitivities, _, _ = roll_out_with_sensitivity(problem, inputs)
    for i in range(knots.size):
        change = np.zeros(knots.size)
        change[i] = STEP * problem.input_scale
        bend = np.vstack((np.zeros(2), change.reshape(-1, 2)))
        ahead, behind = (roll_out(problem, inputs + sign * bend)[0] for sign in (1.0, -1.0))
        found = (ahead - behind) / (2.0 * change[i])
        assert np.allclose(found, sensitivities[:, :, i], atol=DIFFERENCE_TOLERANCE)


def test_gradient_agrees_with_finite_differences(point):
    problem, knots = point
    v = knots.ravel() / problem.input_scale
    gradient, _ = expand(problem, v)
    for i in range(v.size):
        change = np.zeros(v.size)
        change[i] = STEP
        found = (cost(problem, v + change)[0] - cost(problem, v - change)[0]) / (2.0 * STEP)
        assert found == pytest.approx(gradient[i], abs=1e-6, rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_compiled_expansion_agrees_with_the_reference(make_problem, kind, seed):
    problem = make_problem(kind, seed)
    knots = np.random.default_rng(seed).uniform(-100.0, 100.0, (problem.intervals, 2))
    v = knots.ravel() / problem.input_scale
    inputs = np.vstack((problem.input_in_force, knots))
    value, states = cost(problem, v)
    _, sensitivities, _, _ = roll_out_with_sensitivity(problem, inputs)
    (gradient, hessian), found = expand(problem, v), expand_compiled(problem, knots)
    scale = np.max(np.abs(hessian))
    assert found["cost"] == pytest.approx(value, rel=ROUNDING)
    assert np.max(np.abs(found["states"] - states)) < ROUNDING
    assert np.max(np.abs(found["sensitivities"] - sensitivities)) < ROUNDING
    assert np.max(np.abs(found["gradient"] - gradient)) < ROUNDING * max(scale, 1.0)
    assert np.max(np.abs(found["hessian"] - hessian)) < ROUNDING * max(scale, 1.0)
