# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Equations of motion in CasADi expressions: the only definition of the controller's model.

The angular momentum about the contact point is conserved and zero from rest on (Eq. 11). With the
body's inertia D - m k k^T about that point, k the world vertical in body axes, this reads

    (D - m k k^T) omega = -I1 [u1, u2, 0]^T,   D = diag(It1 + m, It1 + m, It2 + m),  m = Mt Rs^2,

solved for omega by the Sherman-Morrison formula, so that only the four lumped constants
``p = [Rs, c1, r1, r3]`` remain. With momentum the right-hand side is I1 (h_b - [u1, u2, 0]^T), h_b
the momentum over I1 in body axes: the rotors act as if their speeds were lower by h_b. A centre of
mass at c adds Mt Rs (2 (k.c) 1 - c k^T - k c^T) to the inertia. Divided by It1 + m this needs no
further constant: I1 becomes c1, D becomes diag(1, 1, r1 / r3), m becomes r1, and Mt Rs c becomes
c1 Rs a / g with the imbalance a = Mt g c / I1. `sphere_nmpc.model.disturbance` has the equations
of the momentum. The paper's Eqs. (4) and (12) carry misprints; see ``msg_docs/conventions.md``.

Every function takes and returns CasADi expressions (SX, MX or DM columns).
"""

import casadi as ca

from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.symbolic_rotation import Expression, quaternion_product, rotation_matrix


def body_rate(q: Expression, u: Expression, p: Expression) -> Expression:
    """Return the angular velocity of the shell [rad/s; body frame], shape (3,).

    q is the unit quaternion wxyz, body to world, u are the rotor speeds relative to the shell
    [rad/s], shape (2,), p the lumped constants [Rs, c1, r1, r3].
    """
    c1, r1, r3 = p[1], p[2], p[3]
    k = rotation_matrix(q)[2, :].T
    along = k[0] * u[0] + k[1] * u[1]
    shared = along / (1 - r1 * (k[0] * k[0] + k[1] * k[1]) - r3 * k[2] * k[2])
    return -c1 * ca.vertcat(
        u[0] + r1 * k[0] * shared, u[1] + r1 * k[1] * shared, r3 * k[2] * shared
    )


def world_rate_with_momentum(
    q: Expression, u: Expression, p: Expression, momentum: Expression, imbalance: Expression
) -> Expression:
    """Return the angular velocity of the shell [rad/s; world frame], shape (3,).

    The balance of the momentum is solved in world axes, in which the vertical is constant.
    q, u and p are as in `body_rate`, momentum is h [rad/s; world frame], shape (3,), imbalance
    a [rad/s^2; body frame], shape (3,), of `sphere_nmpc.model.disturbance`.
    """
    radius, c1, r1, r3 = p[0], p[1], p[2], p[3]
    turn = rotation_matrix(q)
    z = turn[:, 2]
    b = ca.mtimes(turn, imbalance) * (c1 * radius / GRAVITY)
    # diag(1, 1, r1 / r3) turned is 1 + (r1 / r3 - 1) z z^T.
    along, equal = (r1 / r3 - 1) * z, 1 + 2 * b[2]
    right = c1 * (momentum - turn[:, 0] * u[0] - turn[:, 1] * u[1])
    # The elimination of a symmetric definite matrix, row by row: fewer products than its inverse.
    one = 1 / (equal + along[0] * z[0])
    m12, m13, m23 = along[0] * z[1], along[0] * z[2] - b[0], along[1] * z[2] - b[1]
    l12, l13 = m12 * one, m13 * one
    two = 1 / (equal + along[1] * z[1] - l12 * m12)
    rest = m23 - l12 * m13
    l23 = rest * two
    three = 1 / (1 - r1 + along[2] * z[2] - l13 * m13 - l23 * rest)
    second = right[1] - l12 * right[0]
    w3 = (right[2] - l13 * right[0] - l23 * second) * three
    w2 = second * two - l23 * w3
    w1 = right[0] * one - l12 * w2 - l13 * w3
    return ca.vertcat(w1, w2, w3)


def momentum_rate(
    q: Expression, world: Expression, shell_radius: Expression, torques: Expression
) -> Expression:
    """Return dh/dt [rad/s^2; world frame], shape (3,); see `sphere_nmpc.model.disturbance`.

    `world` is the angular velocity of the shell [rad/s; world frame], `torques`, shape (5,), are
    [s, a]: of the slope [rad/s^2; world frame] and the imbalance [rad/s^2; body frame].
    """
    a = ca.mtimes(rotation_matrix(q), torques[2:5])
    velocity = rolling_velocity(world, shell_radius)
    turning = ca.cross(world, a) / GRAVITY
    return ca.vertcat(
        torques[0] - a[1] - velocity[1] * turning[2],
        torques[1] + a[0] + velocity[0] * turning[2],
        velocity[1] * turning[0] - velocity[0] * turning[1],
    )


def rolling_velocity(world: Expression, shell_radius: Expression) -> Expression:
    """Return the velocity of the centre that rolls without slipping [m/s], shape (2,) (Eq. 7).

    `world` is the angular velocity [rad/s; world frame] (Eq. 5).
    """
    return shell_radius * ca.vertcat(world[1], -world[0])


def rates(
    q: Expression, momentum: Expression, u: Expression, p: Expression, torques: Expression
) -> tuple[Expression, Expression, Expression]:
    """Return body rate [rad/s; body frame], velocity of the centre [m/s] and dh/dt [rad/s^2].

    q is the unit quaternion wxyz, body to world, momentum h [rad/s; world frame], shape (3,), u
    are the rotor speeds relative to the shell [rad/s], shape (2,), p the lumped constants [Rs, c1,
    r1, r3], and torques, shape (5,), [s, a] of `sphere_nmpc.model.disturbance`.
    """
    if momentum.is_zero() and torques.is_zero():
        body = body_rate(q, u, p)
        world = ca.mtimes(rotation_matrix(q), body)
    else:
        world = world_rate_with_momentum(q, u, p, momentum, torques[2:5])
        body = ca.mtimes(rotation_matrix(q).T, world)
    return body, rolling_velocity(world, p[0]), momentum_rate(q, world, p[0], torques)


def state_rate(x: Expression, u: Expression, p: Expression) -> Expression:
    """Return dx/dt = G(x) u of a pose, shape (6,), without momentum and torques (Eq. 15)."""
    body, velocity, _ = rates(x[2:6], ca.SX.zeros(3), u, p, ca.SX.zeros(5))
    return ca.vertcat(velocity, 0.5 * quaternion_product(x[2:6], ca.vertcat(0, body)))
