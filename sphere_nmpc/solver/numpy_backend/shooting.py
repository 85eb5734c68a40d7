# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Single shooting of all steps of a horizon at once, for CasADi's virtual machine.

That machine takes as long to decode an instruction as to apply it to some tens of numbers. So only
the orientation, a recursion, is computed step by step; everything else, derivatives included, is
computed for all steps together by instructions on vectors.

The derivative of an orientation is a rotation vector e in the world frame, q -> exp(e / 2) q. In
that frame the small rotations of successive steps add up, and a rotation about the vertical only
rotates the displacement that follows. So each step has six columns of derivatives, by e_x, e_y and
the two knots of its interval, where `sphere_nmpc.solver.reference.shooting` has eight.

The step is `sphere_nmpc.model.integrator.cf4_step`: four rates w1 ... w4, each after a rotation,
and two rotations to the end.
"""

from functools import lru_cache

import casadi as ca

from sphere_nmpc.model.symbolic_rotation import (
    Expression,
    Parts,
    exponential_parts,
    left_jacobian_parts,
    matrix_parts,
    product_parts,
    quaternion_product,
    rotation_matrix,
)

COLUMN = 11
"""Inputs of a step: U at the two knots of its interval (2 each), h, r1, r3, Rs, the weight of the
second knot at its start and at its end, and a mark: 1 where the derivatives are those of its own
end. U = -c1 u is the part of the body rate [rad/s] that does not depend on the orientation."""

SENSITIVITY = 12
"""Derivatives of [ex, ey, ez, x, y] at the end, each by ex and by ey before it, and the
displacement up to the end [x, y]."""

BY_KNOTS = 20
"""Derivatives of [x, y, ex, ey, ez] at the end, each by U_x, U_y at the first and second knot."""

_OF_ORIENTATION = [0, 1, 2, 3, 4, 5, 6, 8, 9]
_UNIT_SENSITIVITY = (1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0)


@lru_cache(maxsize=256)
def shooting_function(steps: int) -> ca.Function:
    """Return the shooting of S steps, ``(q, columns) -> (q_end, moved, by_knots, sensitivities)``.

    Parameters are q (4,) and columns (`COLUMN`, S). Results have one row a step: the quaternion at
    its end (4, S), transposed; the displacement (S, 2) [m; world frame]; the derivatives
    (S, `BY_KNOTS`) of [x, y, ex, ey, ez] at the end of the horizon by U_x, U_y at the first and at
    the second knot, those of x first; and the sensitivities (S, `SENSITIVITY`) of that end to the
    step's start. The end of the horizon is that of the last step, or of the next marked one.
    """
    backwards = list(range(steps - 1, -1, -1))
    q, columns = ca.MX.sym("q", 4), ca.MX.sym("columns", COLUMN, steps)
    q_end, rates = _orientation_function().mapaccum(steps)(q, columns[_OF_ORIENTATION, :])
    q_start = ca.horzcat(q, q_end[:, :-1])
    given = _rows(columns)
    changes, moved = _derivatives(_rows(q_start), _rows(rates), given)
    by_orientation = [change[:, :2] for change in changes]
    into = ca.horzcat(*by_orientation, *moved, given[10]).T
    chain = _sensitivity_function().mapaccum(steps)
    sensitivities, used = chain(ca.DM(_UNIT_SENSITIVITY), into[:, backwards])
    by_knots = _at_the_end(_rows(used[:, backwards]), [change[:, 2:] for change in changes])
    outputs = [q_end, ca.horzcat(*moved), ca.horzcat(*by_knots), sensitivities[:, backwards].T]
    return ca.Function("shooting", [q, columns], outputs)


def _orientation_function() -> ca.Function:
    """Return ``(q, column) -> (q_end, w1 ... w4)``, the recursion from step to step."""
    q, column = ca.SX.sym("q", 4), ca.SX.sym("column", 9)
    first, second, h = column[0:2], column[2:4], column[4]
    ratios = ca.vertcat(column[5], column[5], column[6])
    starting, ending = (first + share * (second - first) for share in (column[7], column[8]))
    middle = 0.5 * (starting + ending)

    def rate(k: Expression, free: Expression) -> Expression:
        weighted = ratios * k
        shared = ca.dot(k[0:2], free) / (1 - ca.dot(weighted, k))
        return ca.vertcat(free, 0) + shared * weighted

    def vertical_after(rotation: Expression, k: Expression) -> Expression:
        scalar, vector = exponential_parts(ca.vertsplit(rotation))
        axis = ca.vertcat(*vector)
        twice = 2 * ca.cross(axis, k)
        return k - scalar * twice + ca.cross(axis, twice)

    k = rotation_matrix(q)[2, :].T
    w1 = rate(k, starting)
    k2 = vertical_after(0.5 * h * w1, k)
    w2 = rate(k2, middle)
    w3 = rate(vertical_after(0.5 * h * w2, k), middle)
    w4 = rate(vertical_after(h * (w3 - 0.5 * w1), k2), ending)
    q_end = q
    for rotation in (3 * w1 + 2 * (w2 + w3) - w4, -w1 + 2 * (w2 + w3) + 3 * w4):
        scalar, vector = exponential_parts(ca.vertsplit(h / 12 * rotation))
        q_end = quaternion_product(q_end, ca.vertcat(scalar, *vector))
    return ca.Function("orientation", [q, column], [q_end, ca.vertcat(w1, w2, w3, w4)])


def _sensitivity_function() -> ca.Function:
    """Return ``(after, step) -> (before, used)``, the backward recursion of the sensitivities.

    `used` is `after`, or that of a horizon's end where the step is marked.
    """
    after, step = ca.SX.sym("after", SENSITIVITY), ca.SX.sym("step", SENSITIVITY + 1)
    marked = step[SENSITIVITY]
    used = marked * ca.DM(_UNIT_SENSITIVITY) + (1 - marked) * after
    chained = ca.reshape(used[0:10], 2, 5).T
    left = used[10:12]
    local = ca.reshape(step[0:10], 2, 5).T
    # A rotation about the vertical rotates the remaining displacement.
    by_vertical = ca.vertcat(0, 0, 1, -left[1], left[0])
    before = ca.mtimes(chained, local[0:2, :]) + ca.mtimes(by_vertical, local[2, :])
    before[3:5, :] += local[3:5, :]
    sensitivity = ca.vertcat(ca.vec(before.T), left + step[10:12])
    return ca.Function("sensitivity", [after, step], [sensitivity, used])


def _derivatives(q: Parts, rates: Parts, columns: Parts) -> tuple[Parts, Parts]:
    """Return the derivatives of ex, ey, ez, x, y after each step, and its displacement.

    Derivatives are (S, 6): by ex and ey before the step, and by U_x and U_y at the first and at
    the second knot. The displacement is x and y, (S, 1) each.
    """
    h, r1, r3, radius, share_start, share_end = columns[4:10]
    w1, w2, w3, w4 = (rates[i : i + 3] for i in (0, 3, 6, 9))
    twice = _scaled(2, _sum(w2, w3))
    first = _sum(_scaled(3, w1), _difference(twice, w4))
    last = _sum(_difference(twice, w1), _scaled(3, w4))
    factors = [0.5 * h, 0.5 * h, h / 12, h, h / 12]
    turns = (w1, w2, first, _difference(w3, _scaled(0.5, w1)), last)
    rotation = _together(*(_scaled(f, turn) for f, turn in zip(factors, turns, strict=True)))
    scalar, vector = exponential_parts(rotation)
    to2, to3, to_middle, to4, _ = _apart([scalar, *vector], 5)
    turned = product_parts(_together(q, q, q), _together(to2, to3, to_middle))
    q2, q3, q_middle = _apart(turned, 3)
    q4 = product_parts(q2, to4)
    bases = matrix_parts(_together(q, q, q, q2, q_middle))
    per_turn = _matrix_product(bases, left_jacobian_parts(rotation, ca.horzcat(*factors)))
    stages = matrix_parts(_together(q, q2, q3, q4))
    middle = 0.5 * (share_start + share_end)
    second = ca.horzcat(share_start, middle, middle, share_end)
    knots = _together(*4 * [columns[0:4]])
    free = _sum(_scaled(1 - second, knots[0:2]), _scaled(second, knots[2:4]))
    by_e, by_free = _rate_derivatives(stages, free, ca.horzcat(*4 * [r1]), ca.horzcat(*4 * [r3]))
    by_knots = [[b * weight for weight in (1 - second, second) for b in row] for row in by_free]

    wide_turns = [[_wide(part) for part in turn] for turn in _apart(_flat(per_turn), 5)]
    wide_e = [[_wide(part) for part in stage] for stage in _apart(_flat(by_e), 4)]
    seeds = _apart(_flat(by_knots), 4)

    def change_of_rate(stage: int, e: Parts) -> Parts:
        rest = [ca.horzcat(ca.MX(h.size1(), 2), *row) for row in _threes(seeds[stage], 4)]
        rows = _threes(wide_e[stage], 2)
        return [a * e[0] + b * e[1] + c for (a, b), c in zip(rows, rest, strict=True)]

    def change_of_turn(turn: int, by: Parts) -> Parts:
        return [_dot(row, by) for row in _threes(wide_turns[turn], 3)]

    ones = [ca.DM.zeros(h.size1(), 6) for _ in range(3)]
    ones[0][:, 0] = ones[1][:, 1] = 1
    e1 = [ca.MX(one) for one in ones]
    dw1 = change_of_rate(0, e1)
    e2 = _sum(e1, change_of_turn(0, dw1))
    dw2 = change_of_rate(1, e2)
    e3 = _sum(e1, change_of_turn(1, dw2))
    dw3 = change_of_rate(2, e3)
    e4 = _sum(e2, change_of_turn(3, _difference(dw3, _scaled(0.5, dw1))))
    dw4 = change_of_rate(3, e4)
    dtwice = _scaled(2, _sum(dw2, dw3))
    dfirst = _sum(_scaled(3, dw1), _difference(dtwice, dw4))
    dlast = _sum(_difference(dtwice, dw1), _scaled(3, dw4))
    e_end = _sum(e1, _sum(change_of_turn(2, dfirst), change_of_turn(4, dlast)))

    scale = radius * h / 6
    weights = ca.horzcat(scale, 2 * scale, 2 * scale, scale)
    body = _together(w1, w2, w3, w4)
    world = [weights * _dot(row, body) for row in stages]
    moved = [ca.sum2(world[1]), -ca.sum2(world[0])]
    heading = _apart([weights * part for row in stages[:2] for part in row], 4)
    rates_in_world = _apart(world, 4)
    dx = dy = ca.MX(h.size1(), 6)
    for i, (e, dw) in enumerate(((e1, dw1), (e2, dw2), (e3, dw3), (e4, dw4))):
        rows = _threes([_wide(part) for part in heading[i]], 3)
        wx, wy, wz = (_wide(part) for part in rates_in_world[i])
        dx += _dot(rows[1], dw) + e[2] * wx - e[0] * wz
        dy -= _dot(rows[0], dw) + e[1] * wz - e[2] * wy
    return [*e_end, dx, dy], moved


def _rate_derivatives(
    stages: list[Parts], free: Parts, r1: Expression, r3: Expression
) -> tuple[list[Parts], list[Parts]]:
    """Return the derivatives of the body rates by ex and ey, 3 x 2, and by U, 3 x 2."""
    rx, ry, k = stages
    ratios = [r1, r1, r3]
    weighted = [r * part for r, part in zip(ratios, k, strict=True)]
    inverse = 1 / (1 - _dot(weighted, k))
    shared = (k[0] * free[0] + k[1] * free[1]) * inverse
    slope = [2 * shared * part for part in weighted]
    slope = [inverse * part for part in (free[0] + slope[0], free[1] + slope[1], slope[2])]
    by_x, by_y = _dot(slope, ry), -_dot(slope, rx)
    # The derivative of the vertical in body axes is ry by ex and -rx by ey.
    by_e = [
        [shared * r * y + part * by_x, part * by_y - shared * r * x]
        for r, x, y, part in zip(ratios, rx, ry, weighted, strict=True)
    ]
    by_free = [[part * (inverse * k[0]), part * (inverse * k[1])] for part in weighted]
    by_free[0][0] += 1
    by_free[1][1] += 1
    return by_e, by_free


def _at_the_end(sensitivity: Parts, local: Parts) -> Parts:
    """Return x, y, ex, ey, ez at the end by the knots, from local ones after each step."""
    wide = [ca.repmat(part, 1, 4) for part in sensitivity]
    chained = _threes(wide[:10], 2)
    e_x, e_y, e_z, x, y = local
    by_orientation = [a * e_x + b * e_y for a, b in chained]
    return [
        by_orientation[3] - wide[11] * e_z + x,
        by_orientation[4] + wide[10] * e_z + y,
        by_orientation[0],
        by_orientation[1],
        by_orientation[2] + e_z,
    ]


def _matrix_product(a: list[Parts], b: list[Parts]) -> list[Parts]:
    return [[_dot(row, column) for column in map(list, zip(*b, strict=True))] for row in a]


def _dot(a: Parts, b: Parts) -> Expression:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _sum(a: Parts, b: Parts) -> Parts:
    return [x + y for x, y in zip(a, b, strict=True)]


def _difference(a: Parts, b: Parts) -> Parts:
    return [x - y for x, y in zip(a, b, strict=True)]


def _scaled(factor: Expression, a: Parts) -> Parts:
    return [factor * x for x in a]


def _rows(matrix: Expression) -> Parts:
    """Return the rows of a matrix, each as a column vector of its own."""
    return list(ca.horzsplit(matrix.T))


def _together(*parts: Parts) -> Parts:
    """Return several vectors as one whose components have a column for each."""
    return [ca.horzcat(*component) for component in zip(*parts, strict=True)]


def _apart(parts: Parts, count: int) -> list[Parts]:
    return [list(each) for each in zip(*(ca.horzsplit(p) for p in parts), strict=True)]


def _flat(matrix: list[Parts]) -> Parts:
    return [part for row in matrix for part in row]


def _threes(parts: Parts, width: int) -> list[Parts]:
    """Return a list cut into rows."""
    return [parts[i : i + width] for i in range(0, len(parts), width)]


def _wide(part: Expression) -> Expression:
    return ca.repmat(part, 1, 6)
