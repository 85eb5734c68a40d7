# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Moving-horizon estimate of the state, the disturbances and the plant from poses.

The newest intervals are fitted together by Gauss-Newton least squares; older ones are summed up in
a Gaussian, so that nothing learnt is lost at rest. Where the motion is not explained, events are
looked for: of the hypotheses with another label of one interval the most probable one is taken, by
Laplace's approximation of the evidence.
"""

from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.estimation.equations import (
    LINEAR_RANGE,
    Linearisation,
    NormalEquations,
    Point,
    Prior,
)
from sphere_nmpc.estimation.hypotheses import Event, Hypothesis, noise_variance
from sphere_nmpc.estimation.motion import Interval, Motion, motion
from sphere_nmpc.estimation.posterior import (
    COMMON,
    DISTURBANCE,
    IMBALANCE,
    KNOT,
    LOCAL,
    SHARE,
    SLOPE_ERROR,
    TIGHT,
    Posterior,
    Scaling,
)
from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.model.error_state import POSE_ERROR, error_between, with_block
from sphere_nmpc.model.state import POSE, POSE_SIZE, Vector

_MAX_ITERATIONS = 6
"""Gauss-Newton iterations for each fit at most."""
_SCALE_TOLERANCE = 0.05
"""Relative accuracy of the noise's scale."""
_QUATERNION = np.array([1.0, 1.0, 0.5, 0.5, 0.5])
"""A rotation by a small angle moves its quaternion half as far."""


@dataclass(frozen=True, eq=False)
class _Fit:
    """Point after a fit, the intervals linearised near it, and the equations solved there."""

    point: Point
    motions: list[Motion]
    equations: NormalEquations
    scale: float
    hypothesis: Hypothesis


class MovingHorizon:
    """Moving-horizon estimator that continues from what is known at a pose.

    `pose_deviations`, shape (5,), are those of measured poses; without `momentum` neither momentum
    nor slope nor imbalance is looked for.
    """

    def __init__(
        self, scaling: Scaling, begun: Posterior, pose_deviations: Vector, momentum: bool
    ) -> None:
        self._scaling = scaling
        self._numbers: EstimatorSettings = scaling.numbers
        self._momentum = momentum
        self._pose_deviations = pose_deviations
        self.result = begun
        """What is known after the newest interval."""
        self._restart()

    def _restart(self) -> None:
        """Continue from the result, with an empty window."""
        known = self.result
        information: Vector = np.asarray(np.linalg.inv(known.covariance), dtype=float)
        self._prior = Prior(
            known.knot, known.common, information, np.zeros(LOCAL), known.scale
        )
        self._point = Point((known.knot,), known.common)
        self._motions: list[Motion] = []
        self._hypothesis = Hypothesis(
            unbalanced=known.unbalanced,
            weak=known.weak,
            disturbed=not known.undisturbed,
            pose_noise=known.pose_noise,
        )
        self._scale = known.scale

    def start_at(self, time: float, pose: Vector) -> None:
        """Continue from a pose, shape (6,), measured at `time` [s] after a gap.

        What happened to the momentum in between is not known, if there is any.
        """
        known = self.result
        if not known.undisturbed:
            known = known.with_unknown_momentum(self._numbers)
        variance = self._scaling.pose_variance(known.pose_noise.pose, self._pose_deviations)
        self.result = known.at_pose(time, pose, variance)
        self._restart()

    def observe(self, interval: Interval, time: float) -> None:
        """Take an interval that ends at control time `time` [s] into account."""
        try:
            # The fit of a hypothesis that is far from so may diverge; it is then not chosen.
            with np.errstate(over="ignore", invalid="ignore"):
                self._take(interval, time)
        except Exception:
            # The state at the end of this interval remains unknown but for its pose.
            self.start_at(time, interval.poses[-1])
            raise

    def _take(self, interval: Interval, time: float) -> None:
        numbers = self._numbers
        while len(self._motions) >= numbers.window:
            self._slide()
        newest = motion(interval, self._point.knots[-1], self._point.common, self._scaling)
        reached = np.concatenate((interval.poses[-1], newest.end[POSE_SIZE:]))
        start = Point((*self._point.knots, reached), self._point.common)
        motions = [*self._motions, newest]
        hypothesis = self._hypothesis.extended(self.result.slipped < numbers.slippery)
        fit = self._fitted(start, motions, hypothesis, self._scale)
        surprising = self._surprise(newest, fit) > numbers.rare
        fit = self._with_other_drives(start, motions, fit, surprising)
        fit = self._improved(start, motions, fit, not (surprising or self._is_noisy))
        if surprising or fit.hypothesis.has_event(numbers.recent):
            fit = self._simplified(start, motions, fit)
        self._prior = self._prior_of(fit.hypothesis, fit.motions[0])
        self._point, self._motions = fit.point, fit.motions
        self._hypothesis, self._scale = replace(fit.hypothesis, renewed=False), fit.scale
        self._publish(fit, time)

    @property
    def _is_noisy(self) -> bool:
        """Whether what happens shows over many poses only."""
        noise = self.result.pose_noise
        variance = self._scaling.pose_variance(noise.pose, self._pose_deviations)
        return noise.time > 0.0 or bool(variance[2] > self._numbers.prediction**2)

    def _prior_of(self, hypothesis: Hypothesis, first: Motion) -> Prior:
        """Return the prior, of which a hypothesis may believe less; `first` is its interval."""
        known, numbers, scaling = self._hypothesis, self._numbers, self._scaling
        prior, factor = self._prior, np.zeros((LOCAL, LOCAL))
        deviations = np.concatenate((np.full(5, TIGHT), scaling.deviations))
        if hypothesis.renewed:
            values = np.concatenate((np.zeros(5), self._initial(prior.common)))
            prior = prior.forgetting(np.arange(5, LOCAL), values, deviations**2)
        elif known.begins_disturbed and not hypothesis.begins_disturbed:
            prior = prior.forgetting(DISTURBANCE, np.zeros(8), deviations[DISTURBANCE - 5] ** 2)
        if hypothesis.pose_noise != known.pose_noise:
            # The pose at its knot was measured, too.
            before, after = (
                scaling.pose_covariance(noise, self._pose_deviations, first.rates[0])
                for noise in (known.pose_noise, hypothesis.pose_noise)
            )
            variances, axes = np.linalg.eigh(after - before)
            factor[POSE_ERROR, POSE_ERROR] = axes * np.sqrt(np.maximum(variances, 0.0))
        if hypothesis.torques and not known.torques:
            factor[SLOPE_ERROR, SLOPE_ERROR] = numbers.tilt * np.eye(2)
            if known.unbalanced:
                factor[-3:, -3:] = numbers.imbalance * np.eye(3)
        kept = factor.any(axis=0)
        return prior.blurred(factor[:, kept]) if kept.any() else prior

    def _surprise(self, newest: Motion, fit: _Fit) -> float:
        """Return the normalised square of the newest pose's innovation, or of a larger step."""
        by, numbers = newest.by_unknowns[:5].copy(), self._numbers
        by[:, KNOT:][:, self._hypothesis.fixed] = 0.0
        expected = by @ self.result.covariance @ by.T
        expected += self._scaling.pose_covariance(
            self.result.pose_noise, self._pose_deviations, newest.rates[-1]
        )
        expected += self._scale * noise_variance(newest.turned, numbers) * np.eye(5)
        error = error_between(newest.end[POSE], newest.interval.poses[-1])
        steps = np.sum(fit.equations.whitened[-numbers.recent :] ** 2, axis=1)
        return max(float(error @ np.linalg.solve(expected, error)), *steps.tolist())

    def _fitted(
        self,
        point: Point,
        motions: list[Motion],
        hypothesis: Hypothesis,
        scale: float,
        without: int | None = None,
    ) -> _Fit:
        """Return the fit of a hypothesis, from a point with intervals linearised near it."""
        for iteration in range(_MAX_ITERATIONS):
            given = self._linearisation(point, motions, hypothesis, scale)
            motions = given.motions
            equations = NormalEquations(given, hypothesis, scale, without)
            point = point.moved(equations.step, self._scaling)
            is_linear = self._largest(equations.step) < LINEAR_RANGE
            # After a larger first step the errors are those of the linearisation, too.
            if iteration > 0 or is_linear:
                before, scale = scale, equations.next_scale()
                if is_linear and abs(scale / before - 1.0) < _SCALE_TOLERANCE:
                    break
        return _Fit(point, motions, equations, scale, hypothesis)

    def _largest(self, step: Vector) -> float:
        """Return the largest component of a step in the scale of the unknowns."""
        units, common = self._scaling.units, step[-COMMON:]
        knots = np.abs(step[:-COMMON].reshape(-1, KNOT)) / units[:KNOT]
        return max(float(np.max(knots)), float(np.max(np.abs(common) / units[KNOT:])))

    def _linearisation(
        self, point: Point, motions: list[Motion], hypothesis: Hypothesis, scale: float
    ) -> Linearisation:
        return Linearisation(
            point, self._prior_of(hypothesis, motions[0]), motions, scale,
            hypothesis.pose_noise, self._pose_deviations, self._scaling,
        )

    def _with_other_drives(
        self, start: Point, motions: list[Motion], fit: _Fit, surprising: bool
    ) -> _Fit:
        """Return the more probable one of a fit and another with weak drives, or without.

        Errors do not depend on the share of the limit that drives attain while all ramps are
        less steep, so it is changed beforehand.
        """
        hypothesis, common = fit.hypothesis, start.common.copy()
        steepest = max(one.interval.steepest for one in motions) / self._scaling.acceleration
        if steepest == 0.0 or not (hypothesis.weak or surprising):
            return fit
        common[SHARE] = 1.0 if hypothesis.weak else (1.0 - self._numbers.share) * steepest
        other = replace(hypothesis, weak=not hypothesis.weak)
        found = self._fitted(Point(start.knots, common), motions, other, fit.scale)
        return found if found.equations.cost < fit.equations.cost else fit

    def _improved(
        self, start: Point, motions: list[Motion], fit: _Fit, simpler: bool
    ) -> _Fit:
        """Return the fit of a hypothesis that differs in one respect, if it is more probable.

        With `simpler` events are only taken back, or what shows gradually is found.
        """
        hypothesis, numbers = fit.hypothesis, self._numbers
        cost, likely = hypothesis.cost(numbers), []
        # No event gains more than the square of what is left.
        if simpler and np.sum(fit.equations.whitened**2) >= numbers.rare:
            # What no single interval shows: another slope, noises of the poses.
            likely = [replace(hypothesis, torques=True), *hypothesis.noises]
        if simpler and not likely and cost == 0.0:
            return fit  # nothing costs less
        others = hypothesis.alternatives(numbers.recent, self._momentum)
        if simpler:
            others = [one for one in others if one[1].cost(numbers) < cost or one[1] in likely]
        if not others:
            return fit
        given = self._linearisation(start, motions, hypothesis, fit.scale)
        motions = given.motions
        # Where an event is compared with none, poses within its interval are used for neither.
        known: dict[int | None, float] = {}
        best: dict[Event | None, tuple[float, int | None, Hypothesis]] = {}
        for changed, other in others:
            without = changed if changed in given.within else None
            if without not in known:
                known[without] = _approximate(given, hypothesis, fit.scale, without)
            there = given
            if changed is None:
                there = given.believing(
                    self._prior_of(other, motions[0]), other.pose_noise
                )
            cost = _approximate(there, other, fit.scale, without) - known[without]
            kind = None if changed is None else other.events[changed]
            if cost < best.get(kind, (0.0,))[0]:
                best[kind] = cost, without, other
        # The motion after a push is far from linear in it, so the best of each kind is fitted.
        found, least = fit, 0.0
        for _, without, other in best.values():
            tried, before = self._fitted(start, motions, other, fit.scale), fit
            if without is not None:
                before = self._fitted(start, motions, hypothesis, fit.scale, without)
            cost = tried.equations.cost - before.equations.cost
            if cost < least:
                found, least = tried, cost
        return found

    def _initial(self, common: Vector) -> Vector:
        """Return the common unknowns of the robot as built, shape (9,), with the lag of others."""
        return self._scaling.prior(self._scaling.lag(common))

    def _simplified(
        self, start: Point, motions: list[Motion], fit: _Fit
    ) -> _Fit:
        """Return the fit of a hypothesis with fewer assumptions, if it is more probable.

        Assumptions that no longer predict the motion are dropped.
        """
        best = fit
        for other in fit.hypothesis.simpler:
            knots = tuple(np.concatenate((knot[POSE], np.zeros(5))) for knot in start.knots)
            common = self._initial(start.common) if other.renewed else start.common.copy()
            common[IMBALANCE] = 0.0
            found = self._fitted(Point(knots, common), motions, other, fit.scale)
            if found.equations.cost < best.equations.cost:
                best = found
        return best

    def _slide(self) -> None:
        """Sum up the oldest interval in the prior."""
        first, oldest = Point(self._point.knots[:2], self._point.common), self._motions[0]
        hypothesis = replace(self._hypothesis, events=self._hypothesis.events[:1])
        given = self._linearisation(first, [oldest], hypothesis, self._scale)
        equations = NormalEquations(given, hypothesis, self._scale)
        self._prior = equations.without_first(first, hypothesis)
        self._point = Point(self._point.knots[1:], self._point.common)
        self._motions = self._motions[1:]
        self._hypothesis = self._hypothesis.shortened()

    def _publish(self, fit: _Fit, time: float) -> None:
        events, numbers = fit.hypothesis.events, self._numbers
        covariance = fit.equations.covariance()
        fixed = np.flatnonzero(fit.hypothesis.fixed)
        prior = np.diag(self._scaling.deviations[fixed] ** 2)
        covariance = with_block(covariance, KNOT + fixed, prior)
        slipped = self.result.slipped + 1
        if Event.SLIPPED in events:
            slipped = list(reversed(events)).index(Event.SLIPPED)
        errors = fit.equations.noise
        noise = float(np.sqrt(np.mean((errors * _QUATERNION) ** 2))) if len(errors) else 0.0
        self.result = Posterior(
            time, fit.point.knots[-1], fit.point.common, covariance, fit.hypothesis.is_undisturbed,
            fit.hypothesis.unbalanced, fit.hypothesis.weak, noise, fit.scale, slipped,
            fit.hypothesis.pose_noise,
        )
        disturbed_now = fit.hypothesis.torques or {Event.PUSHED, Event.TILTED} & set(events)
        if not (self.result.undisturbed or disturbed_now) and self.result.is_zero(numbers):
            self.result = self.result.without_disturbance(numbers)
            self._restart()


def _approximate(
    given: Linearisation, hypothesis: Hypothesis, scale: float, without: int | None
) -> float:
    """Return the cost of a hypothesis without another linearisation."""
    equations = NormalEquations(given, hypothesis, scale, without)
    better = equations.next_scale()
    if abs(better / scale - 1.0) > _SCALE_TOLERANCE:
        equations = NormalEquations(given, hypothesis, better, without)
    return equations.cost
