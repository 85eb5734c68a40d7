# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Covariance of a pose: of its error, and about the fixed axes of the world."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.model.error_state import apply_error, error_covariance, fixed_axes_covariance
from sphere_nmpc.model.state import QUATERNION, upright_state

POSE = np.array([1.0, -2.0, 0.5, 0.1, -0.7, 0.5])
POSE[QUATERNION] /= np.linalg.norm(POSE[QUATERNION])
UNDEFINED = np.diag([1e-4, 1e-4, 0.0, 1e-4, 1e-4, -1e-4])
SKEW = np.eye(6) + np.eye(6, k=1)


def turn(pose: np.ndarray) -> Rotation:
    return Rotation.from_quat(pose[[3, 4, 5, 2]])


def test_turns_about_the_world_axes_are_those_of_the_drawn_poses() -> None:
    rng = np.random.default_rng(1)
    root = 1e-4 * rng.normal(size=(5, 5))
    seen = []
    for error in rng.normal(size=(20_000, 5)) @ root.T:
        moved = apply_error(POSE, error)
        seen.append([*(moved - POSE)[:2], *(turn(moved) * turn(POSE).inv()).as_rotvec()])
    covariance = fixed_axes_covariance(POSE, root @ root.T, 3e-3)
    assert covariance[2].tolist() == covariance[:, 2].tolist() == [0.0, 0.0, 9e-6, 0.0, 0.0, 0.0]
    kept = np.delete(np.delete(covariance, 2, 0), 2, 1)
    np.testing.assert_allclose(np.cov(np.transpose(seen)), kept, atol=2e-2 * np.max(kept))
    np.testing.assert_allclose(error_covariance(POSE, covariance), root @ root.T, atol=1e-18)


def test_pose_given_in_rviz_has_no_variance_of_the_tilt() -> None:
    given = np.diag([0.25, 0.25, 0.0, 0.0, 0.0, 0.0685])
    found = error_covariance(upright_state(1.0, 2.0, 0.8), given)
    np.testing.assert_allclose(found, np.diag([0.25, 0.25, 0.0, 0.0, 0.0685]), atol=1e-16)


def test_zeros_are_an_unknown_covariance() -> None:
    assert error_covariance(POSE, np.zeros((6, 6))) is None


@pytest.mark.parametrize("given", [
    UNDEFINED, -np.eye(6), SKEW, np.diag([np.nan, *[1.0] * 5]), np.diag([np.inf, *[1.0] * 5]),
    np.full((6, 6), np.nan), np.diag([1e308, 1e308, 1.0, -1.0, -1e308, 1.0]),
])
def test_matrix_that_is_no_covariance_is_refused(given) -> None:
    with pytest.raises(InvalidInputError, match=r"covariance: given .* positive semi-definite"):
        error_covariance(POSE, given)
