# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rotations as unit quaternions **wxyz** (scalar first), on NumPy arrays.

A quaternion takes body vectors to world ones. Functions with arguments of shape (..., 4) work on
one quaternion or on many, one a row. `sphere_nmpc.model.symbolic_rotation` has the operations on
CasADi expressions.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

NORM_TOLERANCE = 2e-2
"""Largest deviation of the norm of a given quaternion from 1 that is accepted.

As people type it, with two digits: four equal components that lose 0.01 each make the norm 0.02
smaller; (0.7, 0.7), a quarter turn, has 0.98995. Case 1 of the paper, in four digits, has 1.0006.
"""

_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])


def product(a: Vector, b: Vector) -> Vector:
    """Return the Hamilton product of two quaternions, shape (4,): rotation b, then a."""
    # On four numbers Python is faster than NumPy.
    (aw, ax, ay, az), (bw, bx, by, bz) = a.tolist(), b.tolist()
    return np.array((
        aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw,
    ))


def products(a: Vector, b: Vector) -> Vector:
    """Return the products of quaternions, shape (4, K), with one, (4,), or as many, (4, K)."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return np.stack((
        aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw,
    ))


def conjugate(q: Vector) -> Vector:
    """Return the quaternion of the inverse rotation, shape (..., 4)."""
    return q * _CONJUGATE


def exponential(rotation: Vector) -> Vector:
    """Return the unit quaternion, shape (4,), of a rotation vector [rad], shape (3,)."""
    x, y, z = rotation.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    factor = 0.5 if angle == 0.0 else math.sin(0.5 * angle) / angle
    return np.array((math.cos(0.5 * angle), factor * x, factor * y, factor * z))


def logarithm(q: Vector) -> Vector:
    """Return the shortest rotation vector [rad], shape (3,), of a unit quaternion, shape (4,)."""
    w, x, y, z = q.tolist()
    sine = math.sqrt(x * x + y * y + z * z)
    # Both signs of a quaternion are one orientation; the nearer one gives the shorter rotation.
    factor = 2.0 if sine == 0.0 else 2.0 * math.atan2(sine, abs(w)) / sine
    if w < 0.0:
        factor = -factor
    return np.array((factor * x, factor * y, factor * z))


def matrix(q: Vector | Sequence[float]) -> Vector:
    """Return the matrix, shape (3, 3), that takes body vectors to world ones (Eq. 1)."""
    w, x, y, z = q
    return np.array((
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    ))


def from_matrix(turn: Vector) -> Vector:
    """Return the unit quaternion, shape (4,), of a rotation matrix, shape (3, 3)."""
    # Four times the products of its components with each one; the longest row is accurate.
    x, y, z = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
    (a, b, c), sums = np.diag(turn), turn + turn.T
    rows = np.array((
        (1 + a + b + c, x, y, z),
        (x, 1 + a - b - c, sums[0, 1], sums[0, 2]),
        (y, sums[0, 1], 1 - a + b - c, sums[1, 2]),
        (z, sums[0, 2], sums[1, 2], 1 - a - b + c),
    ))
    longest = rows[int(np.argmax(np.diag(rows)))]
    unit: Vector = longest / np.linalg.norm(longest)
    return unit


def vertical(q: Vector) -> Vector:
    """Return the world's vertical k in body axes, shape (..., 3): last row of the matrix."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    up = (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z)
    return np.stack(up, axis=-1)


def to_body(q: Vector, vector: Vector) -> tuple[float, float, float]:
    """Return a world vector, shape (3,), in body axes: v + 2 q x (q x v - w v)."""
    w, x, y, z = q.tolist()
    a, b, c = vector.tolist()
    # The inner product t = q x v - w v, written out: numpy's cross costs 30 us.
    t1, t2, t3 = y * c - z * b - w * a, z * a - x * c - w * b, x * b - y * a - w * c
    return (
        a + 2.0 * (y * t3 - z * t2), b + 2.0 * (z * t1 - x * t3), c + 2.0 * (x * t2 - y * t1)
    )


def nearer_sign(q: Vector, reference: Vector) -> Vector:
    """Return q or -q, whichever is nearer to the reference, shape (..., 4)."""
    away = np.sum(q * reference, axis=-1, keepdims=True) < 0.0
    return np.where(away, -q, q)


def angle_between(a: Vector, b: Vector) -> Vector:
    """Return the angle of the rotation between orientations [rad], 0 to pi, shape (...)."""
    # The chord is accurate for small angles, where arccos of the dot product is not.
    chord = np.linalg.norm(a - nearer_sign(b, a), axis=-1)
    angle: Vector = 4.0 * np.arcsin(np.minimum(1.0, 0.5 * chord))
    return angle


def between(a: Vector, b: Vector) -> float:
    """Return the angle between two vectors, shape (3,) each [rad]."""
    # Accurate for all angles, where arccos of the product is not for small ones.
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


def is_unit(q: Vector) -> NDArray[np.bool_]:
    """Return whether the norm is 1 within `NORM_TOLERANCE`, shape (...); False for nan."""
    # The square of a large component would overflow.
    possible = np.where(np.abs(q) < 2.0, q, np.nan)
    found: NDArray[np.bool_] = np.abs(np.linalg.norm(possible, axis=-1) - 1.0) <= NORM_TOLERANCE
    return found


def random_quaternion(rng: np.random.Generator) -> Vector:
    """Return an orientation drawn uniformly from SO(3), shape (4,)."""
    # A normalised Gaussian vector is uniform on the sphere of unit quaternions.
    q = rng.normal(size=4)
    return np.asarray(q / np.linalg.norm(q))
