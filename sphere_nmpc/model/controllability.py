# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Local controllability of a configuration: rank of the Lie brackets (Theorem 1).

The columns of G(x) and their Lie brackets span the directions that can be reached by small
manoeuvres. With brackets of up to three fields they span all five unless the contact point lies
on the great circle Gamma through the rotors (Eq. 16); with four fields they always do, so the
robot is locally controllable everywhere, and on Gamma its degree of nonholonomy is 4, not 3.
"""

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

from sphere_nmpc.model.dynamics import state_rate
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_nmpc.model.symbolic_rotation import Expression, quaternion_product

THIRD_ORDER = 5
"""Number of the first columns of the bracket matrix that are made from up to three fields."""


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
    brackets = bracket_matrix(state, constants)[:, :THIRD_ORDER]
    if not np.all(np.isfinite(brackets)):
        return Controllability(float("nan"), float("nan"))
    least = np.linalg.svd(brackets, compute_uv=False)[-1]
    return Controllability(distance_to_circle(state), float(least))


def bracket_matrix(state: Vector, constants: LumpedConstants) -> Vector:
    """Return the scaled brackets at a configuration, shape (6,), as columns.

    Returns
    -------
    ndarray, shape (5, 8)
        Rows: displacement over Rs in world x and y, rotation about the three body axes, all [rad].
        Columns: g1, g2; [g1, g2]; [g1, [g1, g2]], [g2, [g1, g2]]; [g1, [g1, [g1, g2]]],
        sqrt(2) [g2, [g1, [g1, g2]]], [g2, [g2, [g1, g2]]].
    """
    return np.array(_bracket_function()(state, constants.as_array()))


@cache
def _bracket_function() -> ca.Function:
    x, p = ca.SX.sym("x", 6), ca.SX.sym("p", 4)

    # Divided by c1 the fields are of order one whatever the inertia of the rotors; a bracket of
    # n fields scales with c1^n and is left of order one by the same division.
    def field(u: list[float]) -> Expression:
        return state_rate(x, ca.DM(u), p) / p[1]

    def bracket(f: Expression, g: Expression) -> Expression:
        return ca.jtimes(g, x, f) - ca.jtimes(f, x, g)

    g1, g2 = field([1.0, 0.0]), field([0.0, 1.0])
    g12 = bracket(g1, g2)
    g112, g212 = bracket(g1, g12), bracket(g2, g12)
    # With the root the last three transform by a rotation when the body is rotated about z, so
    # that the singular values depend on the distance from Gamma alone.
    mixed = ca.sqrt(2.0) * bracket(g2, g112)
    fields = (g1, g2, g12, g112, g212, bracket(g1, g112), mixed, bracket(g2, g212))
    return ca.Function("brackets", [x, p], [ca.horzcat(*(_reduced(f, x, p) for f in fields))])


def _reduced(f: Expression, x: Expression, p: Expression) -> Expression:
    """Return a velocity in R^6 as displacement over Rs and rotation in the body, shape (5,)."""
    conjugate = ca.vertcat(x[2], -x[3:6])
    rotation = 2 * quaternion_product(conjugate, f[2:6])
    return ca.vertcat(f[0:2] / p[0], rotation[1:4])
