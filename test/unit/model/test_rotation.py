# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rotation operations on NumPy arrays and in CasADi against SciPy, and against each other."""

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sphere_nmpc.model import rotation
from sphere_nmpc.model.rotation import Vector
from sphere_nmpc.model.symbolic_rotation import (
    quaternion_exponential,
    quaternion_product,
    rotation_matrix,
)

ROUNDING = 1e-15


def draws(number: int = 30) -> Vector:
    """Return random orientations, shape (number, 4)."""
    rng = np.random.default_rng(5)
    return np.array([rotation.random_quaternion(rng) for _ in range(number)])


def scipy_rotation(q: Vector) -> Rotation:
    return Rotation.from_quat(q[..., [1, 2, 3, 0]])


def test_product_is_the_composition_of_rotations() -> None:
    for a, b in zip(draws()[:-1], draws()[1:], strict=True):
        composed = (scipy_rotation(a) * scipy_rotation(b)).as_matrix()
        for found in (rotation.product(a, b), np.array(quaternion_product(a, b)).ravel()):
            np.testing.assert_allclose(scipy_rotation(found).as_matrix(), composed, atol=ROUNDING)


def test_matrix_takes_body_vectors_to_world_ones() -> None:
    for q in draws():
        expected = scipy_rotation(q).as_matrix()
        np.testing.assert_allclose(rotation.matrix(q), expected, atol=ROUNDING)
        np.testing.assert_allclose(np.array(rotation_matrix(ca.DM(q))), expected, atol=ROUNDING)
        np.testing.assert_allclose(rotation.vertical(q), expected[2], atol=ROUNDING)
        vector = np.array([0.3, -1.2, 0.7])
        np.testing.assert_allclose(rotation.to_body(q, vector), expected.T @ vector, atol=ROUNDING)
        unit = rotation.product(q, rotation.conjugate(q))
        np.testing.assert_allclose(unit, [1.0, 0.0, 0.0, 0.0], atol=ROUNDING)
        found = rotation.from_matrix(expected)
        np.testing.assert_allclose(rotation.nearer_sign(found, q), q, atol=ROUNDING)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-4, 0.3, 2.0, 3.0])
def test_exponential_and_logarithm_agree_with_scipy(angle: float) -> None:
    vector = angle * np.array([0.48, -0.6, 0.64])
    expected = Rotation.from_rotvec(vector).as_quat()[[3, 0, 1, 2]]
    q = rotation.exponential(vector)
    np.testing.assert_allclose(q, expected, atol=ROUNDING)
    for sign in (q, -q):
        np.testing.assert_allclose(rotation.logarithm(sign), vector, rtol=1e-14, atol=1e-23)
    if angle <= 2.0:  # up to which the power series is meant
        series = np.array(quaternion_exponential(ca.DM(vector))).ravel()
        np.testing.assert_allclose(series, expected, atol=2e-16)
