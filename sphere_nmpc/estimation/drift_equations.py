# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Normal equations of the fit with drift: layout of the unknowns, and the terms of the cost.

The unknowns are [scaled parameters (5), imbalance (3)], shape (8,), and at each knot of the
window, which are its poses, [momentum (3), slope (2)], shape (5,). The cost is the sum of squares,
over their standard deviations, of prior, prediction errors, and changes of momentum and slope that
the model does not explain.
"""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.estimation import plant_parameters
from sphere_nmpc.model.state import Vector

COMMON = plant_parameters.SIZE + 3
KNOT = 5
PARAMETERS = slice(0, plant_parameters.SIZE)
IMBALANCE = slice(plant_parameters.SIZE, COMMON)
ERROR = 5
"""Size of the prediction error of a pose."""


def knot(index: int) -> slice:
    """Return where the momentum and slope of a knot are."""
    return slice(COMMON + KNOT * index, COMMON + KNOT * (index + 1))


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Prior of the common unknowns and of the first knot: mean (13,), inverse covariance."""

    mean: Vector
    information: Vector


@dataclass(frozen=True, eq=False)
class Prediction:
    """Prediction over a transition, linearised at common unknowns and first knot `at`, (13,).

    `error`, shape (5,), is that of the predicted pose, `after`, shape (5,), are momentum and slope
    predicted at the end, `by_unknowns`, shape (10, 13), is the derivative of both.
    """

    at: Vector
    error: Vector
    after: Vector
    by_unknowns: Vector

    def moved_to(self, unknowns: Vector) -> Vector:
        """Return [error, after], shape (10,), at other unknowns, shape (13,)."""
        moved: Vector = np.concatenate((self.error, self.after))
        return moved + self.by_unknowns @ (unknowns - self.at)


@dataclass(frozen=True, eq=False)
class Weights:
    """Inverse variances of the terms of a transition.

    They are of the prediction error of the pose, of the change of momentum and slope at its end
    that the model does not explain, shape (5,), and, if it was pushed, of that minus the one at
    its start.
    """

    error: float
    change: Vector
    coupled: Vector | None = None


class NormalEquations:
    """Information matrix and gradient of the cost over a number of transitions.

    It is evaluated at the `unknowns`, shape (8 + 5 (n + 1),); the `prior` is that of the common
    unknowns and the first knot.
    """

    def __init__(self, unknowns: Vector, prior: Gaussian) -> None:
        self.unknowns = unknowns
        self.information: Vector = np.zeros((unknowns.size, unknowns.size))
        self.gradient: Vector = np.zeros(unknowns.size)
        self.cost = 0.0
        """Of prior and changes; that of the pose errors is returned by `add`."""
        self.log_prior = float(np.linalg.slogdet(prior.information[5:, 5:])[1])
        """Logarithm of the determinant of what is known of the drift beforehand."""
        first = np.arange(COMMON + KNOT)
        away = unknowns[first] - prior.mean
        self.information[np.ix_(first, first)] += prior.information
        self.gradient[first] += prior.information @ away
        self.cost += float(away @ prior.information @ away)
        self._change_before: tuple[Vector, Vector] | None = None

    def add(self, index: int, prediction: Prediction, weights: Weights) -> Vector:
        """Add the transition from knot `index` on; return its prediction error, shape (5,)."""
        size = self.unknowns.size
        first = np.r_[0:COMMON, knot(index)]
        predicted = prediction.moved_to(self.unknowns[first])
        rows = np.zeros((2 * KNOT, size))
        rows[:, first] = prediction.by_unknowns
        error, by_error = predicted[:ERROR], rows[:ERROR]
        change, by_change = self.unknowns[knot(index + 1)] - predicted[ERROR:], -rows[ERROR:]
        by_change[:, knot(index + 1)] += np.eye(KNOT)
        self._least_squares(error, by_error, np.full(ERROR, weights.error))
        self.cost += self._least_squares(change, by_change, weights.change)
        self.log_prior += float(np.sum(np.log(weights.change)))
        before, self._change_before = self._change_before, (change, by_change)
        if weights.coupled is not None and before is not None:
            self._least_squares(change - before[0], by_change - before[1], weights.coupled)
        return error

    def _least_squares(self, residual: Vector, jacobian: Vector, weights: Vector) -> float:
        weighted = weights[:, None] * jacobian
        self.information += jacobian.T @ weighted
        self.gradient += weighted.T @ residual
        return float(weights @ residual**2)

    def step(self) -> Vector:
        """Return the Gauss-Newton step."""
        step = np.linalg.solve(self.information, -self.gradient)
        return np.asarray(step, dtype=float)

    def occam(self) -> float:
        """Return half the logarithm of the factor by which the volume of the drift shrank."""
        known = float(np.linalg.slogdet(self.information[5:, 5:])[1])
        return 0.5 * (known - self.log_prior)

    def marginal(self, index: int) -> Gaussian:
        """Return the distribution of the common unknowns and of a knot at the optimum."""
        kept = np.r_[0:COMMON, knot(index)]
        rest = np.setdiff1d(np.arange(self.unknowns.size), kept)
        within = self.information[np.ix_(rest, rest)]
        across = np.linalg.solve(within, self.information[np.ix_(rest, kept)])
        to_rest = self.information[np.ix_(kept, rest)]
        information = self.information[np.ix_(kept, kept)] - to_rest @ across
        gradient = self.gradient[kept] - across.T @ self.gradient[rest]
        information = 0.5 * (information + information.T)
        mean = self.unknowns[kept] - np.linalg.solve(information, gradient)
        return Gaussian(mean, information)
