# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Least squares with deviations that hold where residuals are not independent of each other."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sphere_nmpc.model.state import Vector

_ROUNDING = 1e-8
"""Least deviation of an unknown in its unit [-]."""
_LEAST = 1e-12
"""Information of an unknown without effect, over that of one in its unit [-]."""


def fitted(
    residuals: Callable[[Vector], Vector], start: Vector, units: Vector, groups: NDArray[np.intp],
    step: float = 1e-3,
) -> tuple[Vector, Vector, float]:
    """Return the values that minimise the squares, their deviations, and what is left (rms).

    `units`, shape (n,), are sizes in which the unknowns change alike; derivatives are differences
    over `step` of these. `groups` has the number of the group of each residual: those of a group
    may depend on each other. The deviation is that of independent residuals, or of the scatter
    between the groups, whichever is larger.
    """
    def scaled(values: Vector) -> Vector:
        return residuals(start + values * units)

    def slope(values: Vector) -> Vector:
        here = scaled(values)
        found: Vector = np.column_stack([
            (scaled(values + step * one) - here) / step for one in np.eye(values.size)
        ])
        return found

    found = least_squares(scaled, np.zeros(start.size), jac=slope, xtol=1e-8, ftol=1e-10)
    jacobian, left = found.jac, found.fun
    information = jacobian.T @ jacobian
    floor = _LEAST * max(float(np.max(np.diag(information))), 1.0)
    inverse = np.linalg.inv(information + floor * np.eye(start.size))
    square = float(left @ left) / max(left.size - start.size, 1)
    scores = np.zeros((int(groups.max()) + 1, start.size))
    np.add.at(scores, groups, jacobian * left[:, None])
    spread = inverse @ scores.T @ scores @ inverse
    deviations = np.sqrt(np.maximum(np.diag(inverse) * square, np.diag(spread)))
    deviations = np.maximum(deviations, _ROUNDING)
    return start + found.x * units, deviations * units, float(np.sqrt(square))
