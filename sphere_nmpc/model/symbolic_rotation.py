# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rotations as unit quaternions **wxyz** in CasADi expressions.

Functions named ``..._parts`` take and return vectors as lists of their components. A component
may itself be a column, one row for each of many rotations; then one instruction computes all.
`sphere_nmpc.model.rotation` has the operations on NumPy arrays.
"""

import math
from typing import Any

import casadi as ca

Expression = Any
"""A CasADi SX, MX or DM; CasADi ships no types."""

Parts = list[Expression]
"""A vector or a quaternion by components."""

_EXPONENTIAL_TERMS = 9
"""Terms of the power series in `quaternion_exponential`: rounding accuracy up to 2 rad."""

_TINY = 1e-30
"""Added to a squared angle, which may be zero."""


def quaternion_product(a: Expression, b: Expression) -> Expression:
    """Return the Hamilton product of two quaternions, shape (4,)."""
    return ca.vertcat(*product_parts(a, b))


def rotation_matrix(q: Expression) -> Expression:
    """Return the matrix that takes body vectors to world ones, shape (3, 3) (Eq. 1)."""
    return ca.vertcat(*(ca.horzcat(*row) for row in matrix_parts([q[i] for i in range(4)])))


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


def product_parts(a: Parts, b: Parts) -> Parts:
    """Return the Hamilton product of two quaternions."""
    return [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]


def matrix_parts(q: Parts) -> list[Parts]:
    """Return the rows of the matrix that takes body vectors to world ones (Eq. 1)."""
    w, x, y, z = q
    # Each product once: CasADi's MX does not find repetitions.
    ww, xx, yy, zz = w * w, x * x, y * y, z * z
    xy, xz, yz, wx, wy, wz = x * y, x * z, y * z, w * x, w * y, w * z
    return [
        [ww + xx - yy - zz, 2 * (xy - wz), 2 * (xz + wy)],
        [2 * (xy + wz), ww - xx + yy - zz, 2 * (yz - wx)],
        [2 * (xz - wy), 2 * (yz + wx), ww - xx - yy + zz],
    ]


def exponential_parts(rotation: Parts) -> tuple[Expression, Parts]:
    """Return scalar and vector part of the unit quaternion of a rotation vector [rad]."""
    angle = ca.sqrt(_square(rotation))
    half = ca.sin(0.5 * angle) / angle
    return ca.cos(0.5 * angle), [half * part for part in rotation]


def left_jacobian_parts(rotation: Parts, factors: Expression) -> list[Parts]:
    """Return the left Jacobian of the exponential map times factors, as rows.

    It is the derivative of a rotation by its rotation vector r, as a rotation vector in the frame
    before it: a I + b [r]x + c r r^T with a = sin t / t, b = (1 - cos t) / t^2,
    c = (1 - a) / t^2, t = |r|.
    """
    square = _square(rotation)
    angle = ca.sqrt(square)
    half = ca.sin(0.5 * angle) / angle
    a = 2 * half * ca.cos(0.5 * angle)
    c = factors * (1 - a) / square
    b = factors * 2 * half * half
    a = factors * a
    x, y, z = rotation
    bx, by, bz = (b * part for part in rotation)
    xy, xz, yz = c * x * y, c * x * z, c * y * z
    return [
        [a + c * x * x, xy - bz, xz + by],
        [xy + bz, a + c * y * y, yz - bx],
        [xz - by, yz + bx, a + c * z * z],
    ]


def _square(rotation: Parts) -> Expression:
    x, y, z = rotation
    return x * x + y * y + z * z + _TINY
