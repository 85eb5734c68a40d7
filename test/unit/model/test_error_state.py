# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Errors of poses and states on the plane, SO(3) and the momentum."""

import numpy as np
import pytest

from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.state import angle_error


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-9, 1e-3, 0.5, 3.0])
@pytest.mark.parametrize("degrees", [5, 8])
def test_error_between_a_state_and_the_changed_state_is_the_one_applied(
    degrees: int, size: float
) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        state, error = rng.normal(size=degrees + 1), rng.normal(size=degrees)
        state[2:6] /= np.linalg.norm(state[2:6])
        error *= size / np.linalg.norm(error)
        there = apply_error(state, error)
        assert np.linalg.norm(there[2:6]) == pytest.approx(1.0, abs=1e-14)
        for sign in (1.0, -1.0):  # both quaternions are one orientation
            other = there.copy()
            other[2:6] *= sign
            np.testing.assert_allclose(error_between(state, other), error, atol=1e-12)
        turned = np.linalg.norm(error[2:5])
        assert angle_error(state, there) == pytest.approx(turned, abs=1e-9)
