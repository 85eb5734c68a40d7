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

RANK_TOLERANCE = 1e-6
"""Singular values below this share of the largest count as zero; 2e-5 rad from Gamma."""

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
    rank3 : int
        Rank of the span of brackets of up to three fields: 5, on Gamma 4.
    rank4 : int
        Rank with brackets of four fields: 5 everywhere.
    smallest_singular_value : float
        Of the scaled brackets of up to three fields [-]; 0 on Gamma, about 1.1 times the distance
        [rad] near it for the paper's robot. It depends on that distance alone.
    """

    distance_to_circle: float
    rank3: int
    rank4: int
    smallest_singular_value: float


def distance_to_circle(state: Vector) -> float:
    """Return the angle of the contact point from the circle Gamma [rad], 0 to pi/2.

    Parameters
    ----------
    state : ndarray, shape (6,)
        The result does not depend on the position.
    """
    w, x, y, z = state[QUATERNION]
    # Height of the contact point over the rotors' plane and its distance from the axis, divided by
    # Rs: unlike the arcsine of the height this is accurate everywhere and needs no unit norm.
    height = abs(w * w + z * z - x * x - y * y)
    return float(np.arctan2(height, 2.0 * np.hypot(x * z - w * y, y * z + w * x)))


def controllability(state: Vector, constants: LumpedConstants) -> Controllability:
    """Return distance from Gamma, ranks and smallest singular value; nan and 0 if not finite.

    Parameters
    ----------
    state : ndarray, shape (6,)
        Configuration of the robot.
    constants : LumpedConstants
        Constants of the robot.
    """
    brackets = bracket_matrix(state, constants)
    if not np.all(np.isfinite(brackets)):
        return Controllability(float("nan"), 0, 0, float("nan"))
    third = _singular_values(brackets[:, :THIRD_ORDER])
    fourth = _singular_values(brackets)
    return Controllability(
        distance_to_circle(state), _rank(third), _rank(fourth), float(third[-1])
    )


def bracket_matrix(state: Vector, constants: LumpedConstants) -> Vector:
    """Return the scaled brackets as columns, shape (5, 8).

    Parameters
    ----------
    state : ndarray, shape (6,)
        Configuration of the robot.
    constants : LumpedConstants
        Constants of the robot.

    Returns
    -------
    ndarray, shape (5, 8)
        Rows: displacement over Rs in world x and y, rotation about the three body axes, all [rad].
        Columns: g1, g2; [g1, g2]; [g1, [g1, g2]], [g2, [g1, g2]]; [g1, [g1, [g1, g2]]],
        sqrt(2) [g2, [g1, [g1, g2]]], [g2, [g2, [g1, g2]]].
    """
    return np.array(_bracket_function()(state, constants.as_array()))


def _singular_values(matrix: Vector) -> Vector:
    return np.asarray(np.linalg.svd(matrix, compute_uv=False), dtype=float)


def _rank(singular_values: Vector) -> int:
    return int(np.sum(singular_values > RANK_TOLERANCE * singular_values[0]))


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
