# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Equations of motion in CasADi expressions, from which the compiled model is generated.

The paper conserves the angular momentum about the contact point, zero from rest on (Eq. 11). With
the body's inertia about that point in world axes, z that of the body and e3 the vertical, this is

    (1 + (r1 / r3 - 1) z z^T - r1 e3 e3^T + 2 b3 1 - b e3^T - e3 b^T) omega = c1 (h - u1 x - u2 y)

divided by It1 + m, m = Mt Rs^2: I1 becomes c1, It2 + m becomes r1 / r3, m becomes r1, so that only
the four lumped constants ``p = [Rs, c1, r1, r3]`` remain. x and y are the axes of the rotors, h is
the momentum over I1, and b = Mt Rs c / (It1 + m) = c1 Rs a / g that of a centre of mass at c, with
the imbalance a = Mt g c / I1; both are zero in the paper. `sphere_nmpc.model.disturbance` has the
equations of the momentum. The paper's Eqs. (4) and (12) carry misprints; see
``msg_docs/conventions.md``.

Every function takes and returns CasADi expressions (SX, MX or DM columns). What is zero in an
argument as an expression costs no operation: the paper's model is an instance of this one.
"""

import casadi as ca

from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.symbolic_rotation import Expression, quaternion_product, rotation_matrix


def world_rate(
    q: Expression, momentum: Expression, u: Expression, p: Expression, imbalance: Expression
) -> Expression:
    """Return the angular velocity of the shell [rad/s; world frame], shape (3,).

    q is the unit quaternion wxyz, body to world, momentum h [rad/s; world frame], shape (3,), u
    are the rotor speeds relative to the shell [rad/s], shape (2,), p the lumped constants [Rs, c1,
    r1, r3] and imbalance a [rad/s^2; body frame], shape (3,).
    """
    radius, c1, r1, r3 = p[0], p[1], p[2], p[3]
    turn = rotation_matrix(q)
    z, b = turn[:, 2], ca.mtimes(turn, imbalance) * (c1 * radius / GRAVITY)
    level = 1 / (1 + 2 * b[2])
    upright = 1 / (1 - r1 - level * (b[0] * b[0] + b[1] * b[1]))

    def solved(right: Expression) -> Expression:
        """Solve the equations without the term of z, of which only e3 couples the others."""
        third = upright * (right[2] + level * (b[0] * right[0] + b[1] * right[1]))
        return ca.vertcat(
            level * (right[0] + b[0] * third), level * (right[1] + b[1] * third), third
        )

    # Sherman-Morrison for the term of z.
    rate, along = solved(momentum - turn[:, 0] * u[0] - turn[:, 1] * u[1]), solved(z)
    more = r1 / r3 - 1
    return c1 * (rate - along * (more * ca.dot(z, rate) / (1 + more * ca.dot(z, along))))


def momentum_rate(
    q: Expression, world: Expression, shell_radius: Expression, torques: Expression
) -> Expression:
    """Return dh/dt [rad/s^2; world frame], shape (3,); see `sphere_nmpc.model.disturbance`.

    `world` is the angular velocity of the shell [rad/s; world frame], `torques`, shape (5,), are
    [s, a]: of the slope [rad/s^2; world frame] and the imbalance [rad/s^2; body frame].
    """
    a = ca.mtimes(rotation_matrix(q), torques[2:5])
    # The velocity v is perpendicular to w: v x (w x a) = (v . a) w.
    along = ca.dot(rolling(world, shell_radius), a[0:2]) / GRAVITY
    return ca.vertcat(torques[0] - a[1], torques[1] + a[0], 0) - along * world


def rolling(turn: Expression, shell_radius: Expression) -> Expression:
    """Return the velocity of the centre that rolls without slipping [m/s], shape (2,) (Eq. 7).

    `turn` is the angular velocity [rad/s; world frame] (Eq. 5), or a rotation for a displacement.
    """
    return shell_radius * ca.vertcat(turn[1], -turn[0])


def state_rate(x: Expression, u: Expression, p: Expression) -> Expression:
    """Return dx/dt = G(x) u of a pose, shape (6,), without momentum and torques (Eq. 15)."""
    rate = world_rate(x[2:6], ca.DM.zeros(3), u, p, ca.DM.zeros(3))
    turn = 0.5 * quaternion_product(ca.vertcat(0, rate), x[2:6])
    return ca.vertcat(rolling(rate, p[0]), turn)
