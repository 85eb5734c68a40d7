# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rotations as unit quaternions **wxyz** in CasADi expressions.

`sphere_nmpc.model.rotation` has the operations on NumPy arrays.
"""

import math
from typing import Any

import casadi as ca

Expression = Any
"""A CasADi SX, MX or DM; CasADi ships no types."""

_EXPONENTIAL_TERMS = 9
"""Terms of the power series in `quaternion_exponential`: rounding accuracy up to 2 rad."""


def quaternion_product(a: Expression, b: Expression) -> Expression:
    """Return the Hamilton product of two quaternions, shape (4,)."""
    return ca.vertcat(
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def rotation_matrix(q: Expression) -> Expression:
    """Return the matrix that takes body vectors to world ones, shape (3, 3) (Eq. 1)."""
    w, x, y, z = (q[i] for i in range(4))
    # Each product once: CasADi's MX does not find repetitions.
    ww, xx, yy, zz = w * w, x * x, y * y, z * z
    xy, xz, yz, wx, wy, wz = x * y, x * z, y * z, w * x, w * y, w * z
    return ca.vertcat(
        ca.horzcat(ww + xx - yy - zz, 2 * (xy - wz), 2 * (xz + wy)),
        ca.horzcat(2 * (xy + wz), ww - xx + yy - zz, 2 * (yz - wx)),
        ca.horzcat(2 * (xz - wy), 2 * (yz + wx), ww - xx - yy + zz),
    )


def quaternion_exponential(rotation: Expression) -> Expression:
    """Return the unit quaternion of a rotation vector [rad], shape (4,), up to 2 rad.

    Power series instead of sine over angle: smooth at zero, where that one divides by zero, and
    made of products and sums alone, so that compiled code can evaluate it on vector registers.
    """
    quarter = 0.25 * ca.dot(rotation, rotation)
    cosine: Expression = 0.0
    sine_over_angle: Expression = 0.0
    for n in reversed(range(_EXPONENTIAL_TERMS)):
        cosine = (-1) ** n / math.factorial(2 * n) + quarter * cosine
        sine_over_angle = (-1) ** n / math.factorial(2 * n + 1) + quarter * sine_over_angle
    return ca.vertcat(cosine, 0.5 * sine_over_angle * rotation)
