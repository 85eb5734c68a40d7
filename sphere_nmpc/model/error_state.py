# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Error of a pose or a state: one number for each degree of freedom.

An error is [dx, dy, a1, a2, a3], shape (5,): a displacement [m; world frame] and a rotation vector
[rad; body frame] that is applied after the orientation, q exp(a / 2). Unlike the four components
of a quaternion it has no constraint. That of a state has the momentum's error [rad/s; world frame]
after these, shape (8,).
"""

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import MOMENTUM, POSITION, QUATERNION, STATE_SIZE, Vector

ERROR_SIZE = STATE_SIZE - 1
"""Size of the error of a state: a rotation vector has a number less than a quaternion."""


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
