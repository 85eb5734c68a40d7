# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Normal equations of the moving horizon: the Gaussian posterior of knots and common unknowns.

The cost, -2 log of the posterior, is a sum of squares over their variances: of the prior, of
measured poses, and of the steps at the knots that the model does not explain. The decision
variables are the errors of the knots (10 each), then of the common unknowns (9).
"""

from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.estimation.hypotheses import (
    Event,
    Hypothesis,
    noise_variance,
    step_covariances,
)
from sphere_nmpc.estimation.motion import Motion, motion
from sphere_nmpc.estimation.posterior import (
    COMMON,
    KNOT,
    LOCAL,
    NORMAL,
    TIGHT,
    PoseNoise,
    Scaling,
    apply_knot_error,
    knot_error,
)
from sphere_nmpc.model.error_state import POSE_ERROR, error_between
from sphere_nmpc.model.state import MOMENTUM, POSE, Vector

_PRIOR_ERRORS = 10.0
"""Number of errors that what was known of the noise's scale before weighs as much as."""
LINEAR_RANGE = 3e-3
"""Change, in the scale of the unknowns, up to which a linearisation is kept."""
_BLOCK = 2 * KNOT + COMMON
_NEXT, _MEASURED = slice(KNOT, 2 * KNOT), slice(KNOT, KNOT + 5)
_OWN = np.r_[0:KNOT, 2 * KNOT : _BLOCK]
"""Places in a row of blocks of the knot at the end, its pose, and of the local unknowns."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What older intervals contribute on a knot and the common unknowns: a Gaussian at a point."""

    knot: Vector
    common: Vector
    """Point: knot and common unknowns, shapes (11,) and (9,)."""
    information: Vector
    """Inverse covariance of the local unknowns, for any imbalance and drives, shape (19, 19)."""
    gradient: Vector
    """Gradient there of half the cost, shape (19,)."""
    scale: float
    """Scale of the noise's variance to expect."""

    def blurred(self, factor: Vector) -> "Prior":
        """Return the prior with a covariance F F^T more; `factor` F has shape (19, K)."""
        columns = self.information @ factor
        inner = np.eye(factor.shape[1]) + factor.T @ columns
        gain = np.linalg.solve(inner, columns.T).T
        information = self.information - gain @ columns.T
        gradient = self.gradient - gain @ (factor.T @ self.gradient)
        return replace(
            self, information=0.5 * (information + information.T), gradient=gradient
        )

    def forgetting(
        self, places: NDArray[np.intp], values: Vector, variances: Vector
    ) -> "Prior":
        """Return the prior with other values and variances of some local unknowns, at `places`.

        What it knew of them is dropped, and with it what depended on them. Poses, the first five,
        are always kept.
        """
        kept = np.setdiff1d(np.arange(LOCAL), places)
        across = self.information[np.ix_(kept, places)]
        gain = np.linalg.solve(self.information[np.ix_(places, places)], across.T).T
        information, gradient = np.zeros((LOCAL, LOCAL)), np.zeros(LOCAL)
        information[places, places] = 1.0 / variances
        reduced = self.information[np.ix_(kept, kept)] - gain @ across.T
        information[np.ix_(kept, kept)] = 0.5 * (reduced + reduced.T)
        gradient[kept] = self.gradient[kept] - gain @ self.gradient[places]
        known = np.concatenate((self.knot[MOMENTUM.start :], self.common))
        known[places - 5] = values
        knot = np.concatenate((self.knot[POSE], known[: KNOT - 5]))
        return replace(
            self, knot=knot, common=known[KNOT - 5 :], information=information, gradient=gradient
        )


@dataclass(frozen=True, eq=False)
class Point:
    """Values of all unknowns: knots, shape (11,) each, and common ones, shape (9,)."""

    knots: tuple[Vector, ...]
    common: Vector

    def moved(self, step: Vector, scaling: Scaling) -> "Point":
        """Return the point after a step of the decision variables, within their range."""
        errors = step[:-COMMON].reshape(-1, KNOT)
        knots = tuple(map(apply_knot_error, self.knots, errors))
        return Point(knots, scaling.within(self.common + step[-COMMON:]))


class Linearisation:
    """What the normal equations of all hypotheses share at a point.

    Intervals are linearised again where the point has left the range of their linearisation.

    Each interval has a row of blocks for the step at its end, with derivatives by the knots at
    both of its ends and the common unknowns, (10, 29). Measured poses have the deviations
    `pose_deviations`, shape (5,) [m, rad], and beside them a noise; `scale` is that of the noise's
    variance for the poses within the intervals.
    """

    def __init__(
        self,
        point: Point,
        prior: Prior,
        motions: list[Motion],
        scale: float,
        noise: PoseNoise,
        pose_deviations: Vector,
        scaling: Scaling,
    ) -> None:
        count = len(motions)
        self.scaling, self.motions, self._aways = scaling, list(motions), np.empty((count, LOCAL))
        self._pose_deviations = pose_deviations
        self.point, self.common, self.scale = point, point.common, scale
        self.jacobians = np.zeros((count, KNOT, _BLOCK))
        self.jacobians[:, :, _NEXT] = np.eye(KNOT)
        self.residuals, self.innovations = np.empty((count, KNOT)), np.empty((count, 5))
        for k, moved in enumerate(motions):
            away = away_from(moved, point, k)
            if float(np.max(np.abs(away) / scaling.units)) > LINEAR_RANGE:
                moved = motion(moved.interval, point.knots[k], point.common, scaling)
                away = np.zeros(LOCAL)
            end, self._aways[k], self.motions[k] = point.knots[k + 1], away, moved
            self.jacobians[k][:, _OWN] = -moved.by_unknowns
            self.residuals[k] = knot_error(moved.end, end) - moved.by_unknowns @ away
            self.innovations[k] = error_between(end[POSE], moved.interval.poses[-1])
        numbers = scaling.numbers
        self.durations = np.array([one.interval.duration for one in motions])
        self.variances = np.array([noise_variance(m.turned, numbers) for m in self.motions])
        self._believe(prior, noise)

    def believing(self, prior: Prior, noise: PoseNoise) -> "Linearisation":
        """Return the equations with another prior and another noise of the poses."""
        other = copy(self)
        other._believe(prior, noise)
        return other

    def _believe(self, prior: Prior, noise: PoseNoise) -> None:
        self.prior, away = prior, away_from(prior, self.point, 0)
        self.by_prior = prior.information @ away + prior.gradient
        self.cost = float(away @ (self.by_prior + prior.gradient))
        self.cost -= float(np.linalg.slogdet(prior.information)[1])
        given, rates = self._pose_deviations, np.array([one.rates[-1] for one in self.motions])
        at_end = self.scaling.pose_covariance(noise, given, rates)
        self.cost += float(np.sum(np.linalg.slogdet(at_end)[1]))
        self.pose_weights: Vector = np.asarray(np.linalg.inv(at_end), dtype=float)
        """Inverse covariances of the poses at the ends of the intervals, (n, 5, 5)."""
        self.within: dict[int, tuple[Vector, Vector, float]] = {}
        """Information (19, 19), gradient (19,) and cost of the poses within an interval."""
        for k, moved in enumerate(self.motions):
            if len(moved.innovations):
                shared = len(moved.innovations) * self.scale * self.variances[k]
                within = self.scaling.pose_covariance(noise, given, moved.rates[1:-1])
                self.within[k] = _poses_within(moved, self._aways[k], within + shared * np.eye(5))


def away_from(known: Prior | Motion, point: Point, index: int) -> Vector:
    """Return the local unknowns of a point, with the knot `index`, from another, (19,)."""
    error = knot_error(known.knot, point.knots[index])
    return np.concatenate((error, point.common - known.common))


def _poses_within(
    moved: Motion, away: Vector, covariances: Vector
) -> tuple[Vector, Vector, float]:
    """Return information, gradient and cost of the poses within an interval.

    Their `covariances` have shape (M, 5, 5). They share the error of the prediction: each of M
    counts as if that were sqrt(M) as large.
    """
    innovations, by = moved.innovations - moved.by_pose @ away, moved.by_pose
    weights: Vector = np.asarray(np.linalg.inv(covariances), dtype=float)
    weighted, by = (weights @ by).reshape(-1, LOCAL), by.reshape(-1, LOCAL)
    information: Vector = weighted.T @ by
    gradient: Vector = -(weighted.T @ innovations.ravel())
    cost = float(np.sum(np.linalg.slogdet(covariances)[1]))
    return information, gradient, cost + _squares(weights, innovations)


def _squares(weights: Vector, errors: Vector) -> float:
    """Return the sum of the squares of errors, shape (n, 5), with weights (n, 5, 5)."""
    return float(np.einsum("ki,kij,kj->", errors, weights, errors))


@lru_cache(maxsize=16)
def _places(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the decision variables of `count` rows of blocks, shape (29 n,).

    The second array, shape (841 n,), has the places of their products in the information.
    """
    size = KNOT * (count + 1) + COMMON
    knots = KNOT * np.arange(count)[:, None] + np.arange(2 * KNOT)
    common = np.tile(np.arange(size - COMMON, size), (count, 1))
    unknowns = np.hstack((knots, common))
    return unknowns.ravel(), (size * unknowns[:, :, None] + unknowns[:, None, :]).ravel()


class NormalEquations:
    """Normal equations of a hypothesis, with a scale of the noise, and their solution.

    Poses within an interval are not used where an event happened, as its time is unknown, nor in
    the interval `without`.
    """

    def __init__(
        self,
        given: Linearisation,
        hypothesis: Hypothesis,
        scale: float,
        without: int | None = None,
    ) -> None:
        self._expected = given.prior.scale
        self._scale, count, numbers = scale, len(given.motions), given.scaling.numbers
        covariances = step_covariances(
            given.motions, given.durations, scale * given.variances, hypothesis, given.scaling
        )
        factors = np.linalg.cholesky(covariances)
        inverse = np.linalg.inv(factors)
        jacobians = inverse @ given.jacobians
        errors = inverse @ given.residuals[:, :, None]
        blocks = jacobians.transpose(0, 2, 1) @ jacobians
        gradients = (jacobians.transpose(0, 2, 1) @ errors)[:, :, 0]
        blocks[:, _MEASURED, _MEASURED] += given.pose_weights
        gradients[:, _MEASURED] -= np.einsum(
            "kij,kj->ki", given.pose_weights, given.innovations
        )
        cost = hypothesis.cost(numbers) + given.cost
        cost += _PRIOR_ERRORS * (given.prior.scale / scale + float(np.log(scale)))
        cost += float(np.sum(errors**2))
        cost += 2.0 * float(np.sum(np.log(np.diagonal(factors, axis1=1, axis2=2))))
        cost += _squares(given.pose_weights, given.innovations)
        for k, (information, gradient, more) in given.within.items():
            if hypothesis.events[k] is Event.NONE and k != without:
                blocks[k][np.ix_(_OWN, _OWN)] += information
                gradients[k][_OWN] += gradient
                cost += more
        size = KNOT * (count + 1) + COMMON
        unknowns, entries = _places(count)
        sums = np.bincount(entries, blocks.ravel(), size * size)
        self.information: Vector = np.asarray(sums, dtype=float).reshape(size, size)
        sums = np.bincount(unknowns, gradients.ravel(), size)
        self.gradient: Vector = np.asarray(sums, dtype=float)
        first = np.r_[0:KNOT, size - COMMON : size]
        self.information[np.ix_(first, first)] += given.prior.information
        self.gradient[first] += given.by_prior
        # The prior is for any imbalance and drives.
        fixed, away = hypothesis.fixed, given.common - NORMAL
        places = np.flatnonzero(fixed) + size - COMMON
        self.information[places, places] += TIGHT**-2
        self.gradient[places] += away[fixed] * TIGHT**-2
        cost += float(np.sum(away[fixed] ** 2)) * TIGHT**-2
        cost += 2.0 * float(np.sum(np.log(TIGHT / given.scaling.deviations[fixed])))
        # SciPy's triangular solver is faster, but its import takes as long as all others here.
        self.step: Vector = np.asarray(np.linalg.solve(self.information, -self.gradient))
        """Gauss-Newton step of the decision variables, shape (10 n + 19,)."""
        self._keep_range(given, fixed)
        self._factor: Vector = np.asarray(np.linalg.cholesky(self.information))
        known = 2.0 * float(np.sum(np.log(np.diag(self._factor))))
        change = 2.0 * self.gradient + self.information @ self.step
        self.cost = cost + float(change @ self.step) + known
        """Cost after the step: -2 log of the probability of the poses, up to a constant."""
        kept = [k for k, event in enumerate(hypothesis.events) if event is Event.NONE]
        knots, common = self.step[:-COMMON].reshape(-1, KNOT), self.step[-COMMON:]
        moved = np.hstack((knots[:-1], knots[1:], np.tile(common, (count, 1))))[kept, :, None]
        self.whitened: Vector = (errors[kept] + jacobians[kept] @ moved)[:, :, 0]
        """Steps that are left at the ends of the intervals without an event, over their standard
        deviations, shape (n, 10)."""
        deviations = np.sqrt(scale * given.variances[kept])
        self.noise: Vector = deviations[:, None] * self.whitened[:, POSE_ERROR]
        """Errors of predicted poses in these steps [m, rad], shape (n, 5), but by the drives."""

    def _keep_range(self, given: Linearisation, fixed: NDArray[np.bool_]) -> None:
        """Change the step so that common unknowns which would leave their range end at its end.

        Those that are `fixed` differ from their values by rounding.
        """
        wanted = given.common + self.step[-COMMON:]
        kept = given.scaling.within(wanted)
        beyond = np.flatnonzero((kept != wanted) & ~fixed)
        if not beyond.size:
            return
        places = self.step.size - COMMON + beyond
        free = np.setdiff1d(np.arange(self.step.size), places)
        self.step[places] = (kept - given.common)[beyond]
        forced = self.gradient + self.information[:, places] @ self.step[places]
        inner = self.information[np.ix_(free, free)]
        self.step[free] = np.linalg.solve(inner, -forced[free])

    def next_scale(self) -> float:
        """Return the scale of the noise that the errors after the step show, at least 1."""
        errors = self.whitened[:, POSE_ERROR]
        total = self._scale * float(np.sum(errors**2))
        known = _PRIOR_ERRORS * self._expected
        return max(1.0, (total + known) / (errors.size + _PRIOR_ERRORS))

    def covariance(self) -> Vector:
        """Return that of the newest knot and the common unknowns, shape (19, 19)."""
        # The factor is triangular, and these unknowns are the last ones. A product with its
        # transpose is never negative, however different the variances are.
        inverse = np.linalg.inv(self._factor[-LOCAL:, -LOCAL:])
        covariance: Vector = inverse.T @ inverse
        return covariance

    def without_first(self, point: Point, hypothesis: Hypothesis) -> Prior:
        """Return what the prior and the first interval contribute on the knot at its end.

        `point` is the point of the equations, which have no other interval.
        """
        information, by = self.information.copy(), self.gradient.copy()
        fixed = hypothesis.fixed
        places = np.flatnonzero(fixed) + 2 * KNOT
        information[places, places] -= TIGHT**-2
        by[places] -= (point.common - NORMAL)[fixed] * TIGHT**-2
        gain = np.linalg.solve(information[:KNOT, :KNOT], information[:KNOT, KNOT:]).T
        kept = information[KNOT:, KNOT:] - gain @ information[:KNOT, KNOT:]
        return Prior(
            point.knots[1], point.common, 0.5 * (kept + kept.T), by[KNOT:] - gain @ by[:KNOT],
            self.next_scale(),
        )
