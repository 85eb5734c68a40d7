# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Least-squares estimate of the plant's four lumped constants, its lag and its noise.

Masses and inertias enter the motion through [Rs, c1, r1, r3] alone. Rotors that follow the
commanded speeds with a first-order lag move the sphere as if all commands had been sent later by
that lag, to second order in it; a pose whose stamp is late by a constant has the same effect. So
the lag is the fifth parameter. Each pair of poses with the rotor speeds sent in between is a
measurement of all five; the newest ones are fitted together by Gauss-Newton least squares with a
Gaussian prior, around the values of the robot as built unless others are given. The residuals of
the fit are the noise.

Drives at their torque limit do not follow steep ramps: the rotors of a robot with heavier rotors
than assumed fall behind. The share of the acceleration limit that they attain is a sixth unknown;
without it their delay is taken for wrong constants, a long lag or momentum.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.estimation.contract import PlantEstimate
from sphere_nmpc.estimation.plant_parameters import (
    LONGEST_LAG,
    PRIOR_DEVIATION,
    SIZE,
    ParameterDistribution,
    ParameterScaling,
    significant,
)
from sphere_nmpc.estimation.transition import Transition
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import POSE, Vector, nearer_sign, without_momentum
from sphere_nmpc.solver.roll_out import roll_out

LEAST_NOISE = 1e-5
"""Floor of the noise [m, -]: the error of the prediction itself over a sample period."""
EXCITED = 2.0
"""Rotor speed [rad/s] below which a transition holds no information about the constants."""
JUMP = 0.25
"""Prediction error [mixed units] above which something other than the rotors moved the robot."""

_WINDOW = 40
"""Transitions fitted together."""
_NOISE_WINDOW = 20
"""Residuals from which the noise is estimated."""
_STEP = 0.05
"""Longest integration step of the prediction [s]."""
_DIFFERENCE = 1e-5
"""Step of the finite differences, in scaled parameters."""
_CONVERGED = 1e-5
"""Change of the scaled parameters at which the iteration ends."""
_ITERATIONS = 6
"""Gauss-Newton iterations for each new transition at most."""
_BOLD_ITERATIONS, _FIRST = 6, 4
"""Iterations with the prior noise, before the others, and the number of transitions up to which
they are made: constants far from the prior would otherwise pass for noise at first, which then
gives the transitions too little weight to leave the prior."""
_STILL_LINEAR = 3e-3
"""Change, in standard deviations of the prior, up to which a linearisation is kept: its error is
then below `LEAST_NOISE`, and a new transition costs one linearisation instead of all of them."""
_FREEDOM = 5
"""Independent components of a state: the quaternion's norm is one."""
_SHARE = SIZE
"""Index of the share of the acceleration limit that the drives attain."""
_SHARE_PRIOR = 0.15
"""Its prior standard deviation [-], around 1."""
_LEAST_SHARE = 0.4
"""Its lower bound; the upper one is 1."""
_SHARE_STEP = 0.02
"""Step of its finite difference, downwards: ramps of plans are slightly below the limit."""
_SHARE_SPREAD = 0.03
"""Standard deviation of its difference between transitions: a limit of torque is one of
acceleration that depends on the motion of the shell."""
_ATTAINED = 0.98
"""Share above which the drives count as attaining the limit."""
_TOLD_APART = 2
"""Transitions that tell weak drives from wrong constants; with fewer the share is kept."""
_EXPLAINED, _EXPLAINED_SHARE = 5e-4, 0.5
"""Noise of the fit [m, -], and over that with the share kept, above which it is kept: then a push
or slip has moved the sphere."""
_EXPECTED_NOISE = 1e-4
"""Prior noise [m, -] ..."""
_EXPECTED_WEIGHT = 5.0
"""... and the number of independent residuals that it weighs as much as."""


@dataclass(frozen=True, eq=False)
class _Linearisation:
    """Residual (6,) and Jacobian (6, 6) of a transition at the unknowns `at`, shape (6,)."""

    at: Vector
    residual: Vector
    jacobian: Vector

    def whitened(self, at: Vector, variance: float) -> tuple[Vector, Vector]:
        """Return residual (6,) and Jacobian (6, 6) at unknowns near the linearisation.

        Where the drives saturate the share of this transition differs from the others' by
        `_SHARE_SPREAD`; the component along its effect is scaled to the variance of the others.
        """
        jacobian = self.jacobian
        residual = self.residual + jacobian @ (at - self.at)
        along = jacobian[:, _SHARE]
        square = float(along @ along)
        if square == 0.0:
            return residual, jacobian
        reduced = (1.0 - (1.0 + _SHARE_SPREAD**2 * square / variance) ** -0.5) / square
        residual = residual - reduced * along * float(along @ residual)
        return residual, jacobian - reduced * np.outer(along, along @ jacobian)


@dataclass(eq=False)
class _Fitted:
    """A transition of the window with its last linearisation."""

    transition: Transition
    linearisation: _Linearisation | None = None


@dataclass(frozen=True, eq=False)
class _Fit:
    """Result of an update: distribution of the parameters, last residuals, and the estimate."""

    parameters: ParameterDistribution
    share: float
    residuals: tuple[Vector, ...]
    estimate: PlantEstimate


class PlantEstimator:
    """Least-squares fit of the parameters to the newest transitions.

    The result of an update is published as a whole when the update is complete: another thread
    may read `estimate` and `parameters` at any time. `mean`, shape (5,), is that of the prior in
    scaled parameters, by default of the robot as built, without lag; `acceleration` the limit of
    the speeds sent [rad/s^2], of which the drives attain `share`, as known so far.
    """

    def __init__(
        self,
        nominal: LumpedConstants,
        mean: Vector | None = None,
        acceleration: float = np.inf,
        share: float = 1.0,
    ) -> None:
        self._nominal = nominal
        self._scaling = ParameterScaling(nominal)
        self._acceleration = acceleration
        mean = ParameterDistribution.prior(0.0).mean if mean is None else mean
        self._mean: Vector = np.append(mean, share)
        self._transitions: tuple[_Fitted, ...] = ()
        self._publish(ParameterDistribution(mean, np.diag(PRIOR_DEVIATION**2)), share, ())

    @property
    def estimate(self) -> PlantEstimate:
        """Constants, lag, noise and standard deviations after the last complete update."""
        return self._fit.estimate

    @property
    def parameters(self) -> ParameterDistribution:
        """Distribution of the scaled parameters after the last complete update."""
        return self._fit.parameters

    @property
    def share(self) -> float:
        """Share of the acceleration limit that the drives attain."""
        return self._fit.share

    def saturated(self, transition: Transition) -> bool:
        """Return whether the drives did not follow the speeds of a transition or its lead."""
        return transition.steepest > self.estimate.acceleration

    def restarted(self, lag: float) -> "PlantEstimator":
        """Return a new estimator with the present constants and another lag [s] as prior.

        Transitions are not taken over, as they hold the old lag; the noise is.
        """
        fit = self._fit
        mean = fit.parameters.with_lag_prior(lag).mean
        new = PlantEstimator(self._nominal, mean, self._acceleration, fit.share)
        new._publish(new.parameters, fit.share, fit.residuals)
        return new

    def observe(self, transition: Transition) -> None:
        """Take a transition into account."""
        parameters, share = self.parameters, self.share
        unknowns = np.append(parameters.mean, share)
        residual = self._residual(self._driven(transition, share), unknowns)
        if float(np.linalg.norm(residual)) > JUMP:
            return
        residuals = self._fit.residuals
        if float(np.max(np.abs(transition.window(LONGEST_LAG)[1]))) > EXCITED:
            newest = _Fitted(transition)
            transitions = (*self._transitions, newest)[-_WINDOW:]
            alone = len(transitions) < _TOLD_APART
            parameters, share, noise = self._fitted(unknowns, transitions, keep_share=alone)
            if noise > _EXPLAINED and share != unknowns[_SHARE]:
                kept = self._fitted(unknowns, transitions, keep_share=True)
                if noise > _EXPLAINED_SHARE * kept[2]:
                    parameters, share, _ = kept
            self._transitions = transitions
            unknowns = np.append(parameters.mean, share)
            if abs(share - self.share) > _SHARE_STEP:
                residuals = ()  # Those of drives that attain another share are no noise.
            if share < _ATTAINED:
                part = self._linearised(newest, unknowns)
                residual, _ = part.whitened(unknowns, noise_variance(residuals, 0))
            else:
                residual = self._residual(self._driven(transition, share), unknowns)
        self._publish(parameters, share, (*residuals, residual)[-_NOISE_WINDOW:])

    def _publish(
        self, parameters: ParameterDistribution, share: float, residuals: tuple[Vector, ...]
    ) -> None:
        scaling, mean = self._scaling, parameters.mean
        estimate = PlantEstimate(
            scaling.lumped(mean),
            significant(scaling.lag(mean)),
            shown_noise(residuals),
            scaling.constants(np.sqrt(np.diag(parameters.covariance))),
            share * self._acceleration if share < _ATTAINED else np.inf,
        )
        self._fit = _Fit(parameters, share, residuals, estimate)

    def _fitted(
        self, unknowns: Vector, transitions: tuple[_Fitted, ...], keep_share: bool = False
    ) -> tuple[ParameterDistribution, float, float]:
        """Return parameters and share that fit all transitions, and the noise that is left.

        Starts from the unknowns so far, shape (6,).
        """
        prior = 1.0 / np.append(PRIOR_DEVIATION, _SHARE_PRIOR) ** 2
        variance = expected = noise_variance((), 0)
        bold = _BOLD_ITERATIONS if len(transitions) <= _FIRST else 0
        for iteration in range(bold + _ITERATIONS):
            before = unknowns
            parts = [
                self._linearised(fitted, before).whitened(before, variance)
                for fitted in transitions
            ]
            residuals = [residual for residual, _ in parts]
            variance = expected if iteration < bold else noise_variance(residuals, SIZE)
            residual, jacobian = np.concatenate(residuals), np.vstack([j for _, j in parts])
            information = np.diag(prior) + jacobian.T @ jacobian / variance
            right = (self._mean - before) * prior - jacobian.T @ residual / variance
            unknowns = self._moved(before, information, right, keep_share)
            converged = float(np.max(np.abs(unknowns - before))) < _CONVERGED
            if converged and iteration >= bold:
                break
        covariance = np.asarray(np.linalg.inv(information), dtype=float)[:SIZE, :SIZE]
        parameters = ParameterDistribution(unknowns[:SIZE], covariance)
        return parameters, float(unknowns[_SHARE]), float(np.sqrt(variance))

    def _moved(
        self, before: Vector, information: Vector, right: Vector, keep_share: bool
    ) -> Vector:
        """Return the unknowns after a step; a share at the end of its range stays there."""
        step = np.linalg.solve(information, right)
        share = min(max(before[_SHARE] + step[_SHARE], _LEAST_SHARE), 1.0)
        if keep_share:
            share = float(before[_SHARE])
        step[_SHARE] = share - before[_SHARE]
        rest = right[:SIZE] - information[:SIZE, _SHARE] * step[_SHARE]
        step[:SIZE] = np.linalg.solve(information[:SIZE, :SIZE], rest)
        return np.append(self._scaling.within(before[:SIZE] + step[:SIZE]), share)

    def _linearised(self, fitted: _Fitted, at: Vector) -> _Linearisation:
        """Return the last linearisation where it still holds at the unknowns, else a new one."""
        known = fitted.linearisation
        if known is not None:
            moved = np.abs(at - known.at) / np.append(PRIOR_DEVIATION, _SHARE_PRIOR)
            if float(np.max(moved)) < _STILL_LINEAR:
                return known
        driven = self._driven(fitted.transition, float(at[_SHARE]))
        residual = self._residual(driven, at)
        jacobian = np.column_stack((
            self._jacobian(driven, at, residual),
            self._by_share(fitted.transition, at, residual),
        ))
        found = fitted.linearisation = _Linearisation(at, residual, jacobian)
        return found

    def _driven(self, transition: Transition, share: float) -> Transition:
        return transition.driven(share * self._acceleration, LONGEST_LAG)

    def _residual(self, driven: Transition, unknowns: Vector) -> Vector:
        """Return prediction minus measurement, shape (6,)."""
        scaled = unknowns[:SIZE]
        durations, inputs = driven.window(self._scaling.lag(scaled))
        constants = self._scaling.constants(scaled)
        start = without_momentum(driven.start)
        predicted = roll_out(start, inputs, durations, constants, _STEP)[-1, POSE]
        difference: Vector = predicted - nearer_sign(driven.end, predicted)
        return difference

    def _jacobian(self, driven: Transition, at: Vector, residual: Vector) -> Vector:
        """Return the derivative of the residual by the scaled parameters, shape (6, 5)."""
        columns = []
        for i in range(SIZE):
            unknowns = at.copy()
            # Inwards at the longest lag, where the window would begin before the lead.
            step = -_DIFFERENCE if self._scaling.is_highest(at, i) else _DIFFERENCE
            unknowns[i] += step
            columns.append((self._residual(driven, unknowns) - residual) / step)
        return np.column_stack(columns)

    def _by_share(self, transition: Transition, at: Vector, residual: Vector) -> Vector:
        """Return the derivative of the residual by the share, shape (6,)."""
        share = float(at[_SHARE]) - _SHARE_STEP
        if transition.steepest <= share * self._acceleration:
            return np.zeros_like(residual)
        return (residual - self._residual(self._driven(transition, share), at)) / _SHARE_STEP


def shown_noise(residuals: Sequence[Vector]) -> float:
    """Return the standard deviation of the noise that residuals show, least without any.

    Unlike the variance that weighs transitions it expects none: a dead band that follows from it
    is widened by what was seen alone.
    """
    return float(np.sqrt(noise_variance(residuals, 0, expected=0.0)))


def noise_variance(
    residuals: Sequence[Vector], fitted: int, expected: float = _EXPECTED_NOISE
) -> float:
    """Return the noise variance shown by residuals after `fitted` parameters were fitted.

    `expected` is the prior standard deviation.
    """
    squares = sum(float(r @ r) for r in residuals)
    freedom = max(1, _FREEDOM * len(residuals) - fitted) if residuals else 0
    prior = _EXPECTED_WEIGHT * expected**2
    return max(LEAST_NOISE**2, (squares + prior) / (freedom + _EXPECTED_WEIGHT))
