# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Local controllability of a configuration: rank of the Lie brackets (Theorem 1).

The columns of G(x) and their Lie brackets span the directions that can be reached by small
manoeuvres. With brackets of up to three fields they span all five unless the contact point lies
on the great circle Gamma through the rotors (Eq. 16); with four fields they always do, so the
robot is locally controllable everywhere, and on Gamma its degree of nonholonomy is 4, not 3.

A field is written by its velocities in the body frame, w = (a, v): rotation and displacement over
Rs, which depend on the vertical k alone. As dk/dt = k x a, and by the structure of the group of
rigid motions, with derivatives by k,

    [f, g] = (dw_g/dk) (k x a_f) - (dw_f/dk) (k x a_g) + (a_f x a_g, a_f x v_g - a_g x v_f).

Divided by c1 the two columns are a = -A^-1 e, v = a x k (Eqs. 7 and 11), with the matrix A of
`sphere_nmpc.model.torque`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import QUATERNION, Vector

_CROSS: Vector = np.zeros((3, 3, 3))
"""The tensor of cross products: (a x b)_i = sum_jk e_ijk a_j b_k."""
_CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_CROSS -= _CROSS.transpose(0, 2, 1)
_GROUP: Vector = np.zeros((6, 6, 6))
"""The tensor of the last term of a bracket."""
_GROUP[:3, :3, :3] = _GROUP[3:, :3, 3:] = _GROUP[3:, 3:, :3] = _CROSS
_NOT_NEEDED: Vector = np.zeros((6, 3, 3))


@dataclass(frozen=True)
class Controllability:
    """Measures of the local controllability of a configuration.

    Attributes
    ----------
    distance_to_circle : float
        Angle between the contact point and the circle Gamma, seen from the centre [rad],
        0 to pi/2.
    smallest_singular_value : float
        Of the scaled brackets of up to three fields [-]; it depends on that distance alone, and
        is 0 on Gamma.
    """

    distance_to_circle: float
    smallest_singular_value: float


def distance_to_circle(state: Vector) -> float:
    """Return the angle of the contact point of a state, shape (6,), from Gamma [rad]."""
    w, x, y, z = state[QUATERNION]
    # Height of the contact point over the rotors' plane and its distance from the axis, divided by
    # Rs: unlike the arcsine of the height this is accurate everywhere and needs no unit norm.
    height = abs(w * w + z * z - x * x - y * y)
    return float(np.arctan2(height, 2.0 * np.hypot(x * z - w * y, y * z + w * x)))


def controllability(state: Vector, constants: LumpedConstants) -> Controllability:
    """Return the measures of a configuration, shape (6,); nan where it is not finite."""
    brackets = third_order_brackets(rotation.vertical(state[QUATERNION]), constants)
    if not np.all(np.isfinite(brackets)):
        return Controllability(float("nan"), float("nan"))
    least = np.linalg.svd(brackets, compute_uv=False)[-1]
    return Controllability(distance_to_circle(state), float(least))


class _Field(NamedTuple):
    """Velocities w of a field, shape (6,), and their derivatives by k."""

    w: Vector
    first: Vector  # (6, 3)
    second: Vector  # (6, 3, 3)


def third_order_brackets(vertical: Vector, constants: LumpedConstants) -> Vector:
    """Return the brackets of up to three fields at a vertical k, shape (3,) [-; body frame].

    Returns
    -------
    ndarray, shape (6, 5)
        Rows: rotation and displacement over Rs, both in the body frame. Columns: g1, g2; [g1, g2];
        [g1, [g1, g2]], [g2, [g1, g2]]; each over c1 to the power of its number of fields, which
        makes it of order one whatever the inertia of the rotors.
    """
    g1, g2 = (_column(vertical, constants, i) for i in range(2))
    g12 = _bracket(vertical, g1, g2)
    higher = (_bracket(vertical, g, g12) for g in (g1, g2))
    return np.column_stack([field.w for field in (g1, g2, g12, *higher)])


def _column(k: Vector, constants: LumpedConstants, rotor: int) -> _Field:
    """Return a column of G(x) over c1, with both derivatives."""
    r1, r3 = constants.transverse_ratio, constants.axial_ratio
    inverse = np.linalg.inv(np.diag((1.0, 1.0, r1 / r3)) - r1 * k[:, None] * k)
    a, up = -inverse[:, rotor], inverse @ k
    # Of the inverse B: dB/dk_m = r1 B (e_m k^T + k e_m^T) B.
    slope = r1 * (inverse[:, None, :] * up[:, None] + up[:, None, None] * inverse)
    da = -slope[:, rotor]
    dda = r1 * (
        (a + k @ da) * inverse[:, :, None] + (k @ a) * slope
        + (inverse + k @ slope)[:, None, :] * a[:, None] + up[:, None, None] * da
    )
    # v = a x k and its derivatives.
    by_a, turned = _CROSS @ k, _CROSS.transpose(0, 2, 1) @ da
    dv = by_a @ da + a @ _CROSS
    ddv = (by_a @ dda.reshape(3, 9)).reshape(3, 3, 3) + turned + turned.transpose(0, 2, 1)
    return _Field(
        np.concatenate((a, by_a @ a)), np.vstack((da, dv)), np.concatenate((dda, ddv))
    )


def _bracket(k: Vector, f: _Field, g: _Field) -> _Field:
    """Return [f, g]; where `g` has no second derivative, without a first one."""
    from_rotation = _CROSS @ k

    def along(by: _Field, of: _Field) -> tuple[Vector, Vector]:
        """Return the derivative of a field along another one, and its derivative by k."""
        a, da = by.w[:3], by.first[:3]
        rate, rate_by_k = -from_rotation @ a, -from_rotation @ da - a @ _CROSS
        return of.first @ rate, of.second @ rate + of.first @ rate_by_k

    (g_along, dg_along), (f_along, df_along) = along(f, g), along(g, f)
    by_g = f.w @ _GROUP
    w = g_along - f_along + by_g @ g.w
    first = dg_along - df_along + (_GROUP @ g.w) @ f.first + by_g @ g.first
    return _Field(w, first, _NOT_NEEDED)
