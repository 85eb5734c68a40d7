# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Derivatives of the plain solver, with which the compiled one is compared."""

import numpy as np
import pytest

from sphere_nmpc.solver.plain import expand

STEP = 1e-6  # of a scaled input; a central difference is then good to about 1e-9

def test_derivatives_agree_with_finite_differences(make_problem, kind):
    problem = make_problem(kind)
    v = np.random.default_rng(1).uniform(-0.9, 0.9, 2 * problem.intervals)
    here = expand(problem, v)
    for i in range(v.size):
        change = np.zeros(v.size)
        change[i] = STEP
        ahead, behind = expand(problem, v + change), expand(problem, v - change)
        slope = (ahead.cost - behind.cost) / (2.0 * STEP)
        assert slope == pytest.approx(here.gradient[i], abs=1e-6, rel=1e-6)
        after, before = (end.motion.states for end in (ahead, behind))
        found = (after - before) / (2.0 * STEP * problem.input_scale)
        assert np.allclose(found, here.motion.derivatives[:, :, i], atol=1e-7)
