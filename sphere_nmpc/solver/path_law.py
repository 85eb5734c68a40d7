# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Law by which the centre follows a path, in CasADi expressions for the code generator.

Without momentum the motion depends on the angles by which the rotors turn alone, not on when: a
path may be followed at any pace. The law is written for a nominal one of Rs in a unit of time. Its
rotor speeds are the least squares of

    V(q) u = v / (1 + rho x / rho_0),   rho w_3(u) = rho (kappa / r3 + K_psi (chi - chi_d)),

v = t / (1 + |e|^2 / e_0^2) + K e the wanted velocity with the tangent t and the curvature kappa of
the path and the error e of the centre, w_3 the spin about the vertical. Where the body's z axis is
not horizontal, V is regular, and the path is followed exactly. On the circle where it is, Gamma,
the sphere rolls along the axis alone: there chi, the angle of v from it, has to be small, and the
second row turns the sphere to what it is wanted to be, chi_d. It weighs

    rho = rho_0 exp(-(tan phi / w)^2 (1 + x)),   x = ((chi - chi_d) / chi_0)^2

at the latitude phi of the contact point: where chi is far from what it is wanted to be, the path
is followed exactly up to nearer to Gamma, and slower. Away from Gamma the heading follows
w_n cos(phi) / |sin phi|^p = C on a straight line, of which any C leads on from Gamma: it is
chosen, and chi_d is the heading that leads to it.
"""

import casadi as ca

from sphere_nmpc.model.dynamics import rolling, world_rate
from sphere_nmpc.model.symbolic_rotation import Expression, rotation_matrix

_GAIN = 4.0
"""Rate K at which an error of the centre decays [1/Rs of the path]. The correction is not faster
than the nominal pace."""
_TURN_GAIN = 20.0
"""Rate K_psi at which the heading turns to what is wanted [1/Rs of the path]."""
_TURN_WEIGHT = 0.3
"""Weight rho_0 of the spin beside the velocity [Rs]."""
_WIDTH = 0.25
"""Tangent w of the latitude within which the spin is weighed."""
_LARGE_HEADING_ERROR = 0.2
"""Error chi_0 of the heading [rad] that is large."""
_MIN_ERROR = 0.05
"""Least e_0 [Rs]."""
LAW_SIZES = {"quaternion": 4, "place": 2, "point": 4, "given": 3, "p": 4}
"""Arguments of `path_law`."""


def path_law(
    quaternion: Expression, place: Expression, point: Expression, given: Expression,
    p: Expression,
) -> Expression:
    """Return [u_1, u_2, g, speed, tan phi] at the nominal pace, shape (5,).

    Speeds of rotors are in rad, that of progress g and of the centre in Rs, each a unit of time.

    Parameters
    ----------
    quaternion, p
        As q and p of `sphere_nmpc.model.dynamics.world_rate`.
    place : shape (2,)
        Place of the centre [m].
    point : shape (4,)
        Where it is to be, a row of `sphere_nmpc.model.path.Path.curve`.
    given : shape (3,)
        [C, 1 before and 0 at the end of the path, e_0 [m]].
    """
    radius, gain, r3 = p[0], p[1], p[3]
    none, still = ca.DM.zeros(3), ca.DM.zeros(3)
    columns = [world_rate(quaternion, none, ca.DM(unit), p, still) for unit in ((1, 0), (0, 1))]
    velocities = [rolling(column, 1.0) for column in columns]  # [Rs]
    axis = rotation_matrix(quaternion)[:, 2]
    level = ca.sqrt(axis[0] ** 2 + axis[1] ** 2 + 1e-18)
    tangent = axis[2] / level
    away = (point[:2] - place) / radius
    distance = ca.sqrt(ca.dot(away, away) + 1e-18)
    pace = given[1] / (1 + (distance * radius / ca.fmax(given[2], _MIN_ERROR * radius)) ** 2)
    velocity = pace * ca.vertcat(ca.cos(point[2]), ca.sin(point[2]))
    velocity += ca.fmin(_GAIN, 1 / distance) * away
    speed = ca.sqrt(ca.dot(velocity, velocity) + 1e-18)
    ahead = pace * ca.vertcat(ca.cos(point[2]), ca.sin(point[2])) + (1 - pace) * away / distance
    bend = point[3] * radius * pace
    along, across = ca.dot(axis[:2], ahead), axis[0] * ahead[1] - axis[1] * ahead[0]
    east = ca.if_else(along >= 0, 1.0, -1.0)
    power = 1 / (1 - r3)
    offset = east * (
        bend * ca.fmin(ca.fmax(tangent, -1.0), 1.0) / (power - 1)
        - given[0] * _exp(power * ca.log1p(ca.fabs(axis[2]) - 1)) / level
    )
    error = ca.atan2(east * across, east * along) - offset
    large = (error / _LARGE_HEADING_ERROR) ** 2
    near = _exp(-((tangent / _WIDTH) ** 2) * (1 + large))
    slower = 1 / (1 + near * large)
    weight = _TURN_WEIGHT * near
    spin = slower * bend / r3 + _TURN_GAIN * ca.fmin(speed, 1.0) * error
    wanted = slower * velocity / ca.fmax(speed, 1.0)
    rows = [ca.vertcat(v, weight * c[2]) for v, c in zip(velocities, columns, strict=True)]
    right = ca.vertcat(wanted, weight * spin)
    a, b, c = (ca.dot(rows[i], rows[j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    first, second = ca.dot(rows[0], right), ca.dot(rows[1], right)
    u = ca.vertcat(c * first - b * second, a * second - b * first) / (a * c - b * b)
    # Rolling along a rotor's axis takes 1 / c1: more is slower.
    share = 1 / ca.fmax(1.0, gain * ca.fmax(ca.fabs(u[0]), ca.fabs(u[1])))
    return ca.vertcat(share * u, share * slower * ca.vertcat(pace, speed), tangent)


def _exp(exponent: Expression) -> Expression:
    """Return the exponential of what is negative.

    The symbols of exp, log and pow in a newer glibc are not found in an older one, those of expm1
    and log1p are.
    """
    return 1 + ca.expm1(exponent)


def path_law_function() -> ca.Function:
    """Return the CasADi function of `path_law`, with the result ``law``."""
    symbols = {name: ca.SX.sym(name, size) for name, size in LAW_SIZES.items()}
    return ca.Function("path_law", [*symbols.values()], [path_law(**symbols)], [*symbols], ["law"])
