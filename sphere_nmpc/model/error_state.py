# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Error of a pose or a state: one number for each degree of freedom.

An error is [dx, dy, a1, a2, a3], shape (5,): a displacement [m; world frame] and a rotation vector
[rad; body frame] that is applied after the orientation, q exp(a / 2). Unlike the four components
of a quaternion it has no constraint. That of a state has the momentum's error [rad/s; world frame]
after these, shape (8,).
"""

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import MOMENTUM, POSITION, QUATERNION, STATE_SIZE, Vector

ERROR_SIZE = STATE_SIZE - 1
"""Size of the error of a state: a rotation vector has a number less than a quaternion."""
POSE_ERROR = slice(0, 5)
EXPECTED_DEVIATIONS = 3.0
"""Standard deviations up to which an error is expected [-]."""
SIGNIFICANT_DEVIATIONS = 4.0
"""Standard deviations from which on what is measured is no noise [-]."""
CONTRADICTING_DEVIATIONS = 6.0
"""Standard deviations beyond which what was given or known until now is contradicted [-]."""
_ROUNDING_SHARE = 1e-6
"""Asymmetry and negative eigenvalues of a given covariance that count as rounding, over its
largest variance [-]."""


def apply_error(state: Vector, error: Vector) -> Vector:
    """Return a pose, shape (6,), changed by an error (5,), or a state (9,) by one of (8,)."""
    q = rotation.product(state[QUATERNION], rotation.exponential(error[2:5]))
    place = state[POSITION] + error[:2]
    return np.concatenate((place, q / np.linalg.norm(q), state[MOMENTUM] + error[5:]))


def error_between(state: Vector, other: Vector) -> Vector:
    """Return the error that leads from one pose or state to another."""
    turn = rotation.product(rotation.conjugate(state[QUATERNION]), other[QUATERNION])
    return np.concatenate((
        other[POSITION] - state[POSITION], rotation.logarithm(turn),
        other[MOMENTUM] - state[MOMENTUM],
    ))


def with_block(covariance: Vector, places: NDArray[np.intp] | slice, own: Vector) -> Vector:
    """Return a covariance with another block at some places, independent of the others."""
    found = covariance.copy()
    found[places, :] = found[:, places] = 0.0
    chosen = np.arange(len(found))[places]
    found[np.ix_(chosen, chosen)] = own
    return found


def place_deviation(covariance: Vector | None) -> float:
    """Return the standard deviation of a position, whatever its direction [m]; 0 if trusted.

    `covariance`, shape (5, 5), is that of the error of a pose; None where that is trusted exactly.
    """
    if covariance is None:
        return 0.0
    return float(np.sqrt(max(covariance[0, 0], covariance[1, 1])))


def state_deviation(covariance: Vector | None) -> float:
    """Return the standard deviation of a pose in R^6 [mixed units], likewise."""
    if covariance is None:
        return 0.0
    variances = np.diag(covariance)
    # A rotation by a small angle moves its quaternion half as far.
    return float(np.sqrt(np.sum(variances[:2]) + 0.25 * np.sum(variances[2:])))


def _by_fixed_axes(pose: Vector) -> Vector:
    """Return the matrix, shape (6, 5), from the error of a pose to [dx, dy, dz, turn; world]."""
    jacobian = np.zeros((6, 5))
    jacobian[:2, :2] = np.eye(2)
    jacobian[3:, 2:] = rotation.matrix(pose[QUATERNION])
    return jacobian


def fixed_axes_covariance(pose: Vector, covariance: Vector, height_deviation: float) -> Vector:
    """Return the covariance of x, y, z [m] and turns about the world's axes [rad], shape (6, 6).

    `covariance`, shape (5, 5), is that of the error of the pose, shape (6,); the height of the
    centre is known as well as the radius, with a standard deviation [m].
    """
    jacobian = _by_fixed_axes(pose)
    found: Vector = jacobian @ covariance @ jacobian.T
    found[2, 2] = height_deviation**2
    return found


def error_covariance(pose: Vector, given: Vector) -> Vector | None:
    """Return the covariance, shape (5, 5), of the error of a pose, shape (6,).

    `given`, shape (6, 6), is that of x, y, z [m] and turns about the world's axes [rad]; zeros
    stand for an unknown one, for which None is returned. One that is not finite, symmetric and
    positive semi-definite raises `InvalidInputError`.
    """
    if not given.any():
        return None
    allowed = _ROUNDING_SHARE * np.max(np.abs(np.diag(given)))
    if np.isfinite(given).all():
        half = 0.5 * given  # sums of the largest numbers would overflow
        symmetric = half + half.T
        if np.max(np.abs(half - half.T)) <= allowed and (
            np.linalg.eigvalsh(symmetric)[0] >= -allowed
        ):
            jacobian = _by_fixed_axes(pose)
            return jacobian.T @ symmetric @ jacobian
    raise InvalidInputError(
        "covariance", given.tolist(), "a finite, symmetric and positive semi-definite matrix, or "
        "zeros where it is unknown",
    )
