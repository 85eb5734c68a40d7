# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Lie brackets of the columns of G(x) (Theorem 1), in CasADi expressions.

Divided by c1 the fields are of order one whatever the inertia of the rotors; a bracket of n fields
scales with c1^n and is left of order one by the same division.
"""

from functools import cache

import casadi as ca
import numpy as np

from sphere_nmpc.model.dynamics import state_rate
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector
from sphere_nmpc.model.symbolic_rotation import Expression, quaternion_product


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
