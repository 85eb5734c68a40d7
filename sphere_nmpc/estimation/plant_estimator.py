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
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.estimation.contract import PlantEstimate
from sphere_nmpc.estimation.plant_parameters import (
    PRIOR_DEVIATION,
    SIZE,
    ParameterDistribution,
    ParameterScaling,
    significant,
)
from sphere_nmpc.estimation.transition import Transition
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector, nearer_sign
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
_STILL_LINEAR = 3e-3
"""Change, in standard deviations of the prior, up to which a linearisation is kept: its error is
then below `LEAST_NOISE`, and a new transition costs one linearisation instead of all of them."""
_FREEDOM = 5
"""Independent components of a state: the quaternion's norm is one."""
_EXPECTED_NOISE = 1e-4
"""Prior noise [m, -] ..."""
_EXPECTED_WEIGHT = 5.0
"""... and the number of independent residuals that it weighs as much as."""


@dataclass(frozen=True, eq=False)
class _Linearisation:
    """Residual (6,) and Jacobian (6, 5) of a transition at the scaled parameters `at`."""

    at: Vector
    residual: Vector
    jacobian: Vector


@dataclass(eq=False)
class _Fitted:
    """A transition of the window with its last linearisation."""

    transition: Transition
    linearisation: _Linearisation | None = None


@dataclass(frozen=True, eq=False)
class _Fit:
    """Result of an update: distribution of the parameters, last residuals, and the estimate."""

    parameters: ParameterDistribution
    residuals: tuple[Vector, ...]
    estimate: PlantEstimate


class PlantEstimator:
    """Least-squares fit of the parameters to the newest transitions.

    The result of an update is published as a whole when the update is complete: another thread
    may read `estimate` and `parameters` at any time.

    Parameters
    ----------
    nominal : LumpedConstants
        Constants of the robot as built.
    mean : ndarray, shape (5,), optional
        Mean of the prior in scaled parameters; by default the robot as built, without lag.
    """

    def __init__(self, nominal: LumpedConstants, mean: Vector | None = None) -> None:
        self._nominal = nominal
        self._scaling = ParameterScaling(nominal)
        self._mean = ParameterDistribution.prior(0.0).mean if mean is None else mean
        self._transitions: tuple[_Fitted, ...] = ()
        self.jumps = 0
        """Transitions left out as something other than the rotors had moved the robot."""
        self._publish(ParameterDistribution(self._mean, np.diag(PRIOR_DEVIATION**2)), ())

    @property
    def estimate(self) -> PlantEstimate:
        """Constants, lag, noise and standard deviations after the last complete update."""
        return self._fit.estimate

    @property
    def parameters(self) -> ParameterDistribution:
        """Distribution of the scaled parameters after the last complete update."""
        return self._fit.parameters

    def restarted(self, lag: float) -> "PlantEstimator":
        """Return a new estimator with the present constants and another lag [s] as prior.

        Transitions are not taken over, as they hold the old lag; the noise is.
        """
        fit = self._fit
        new = PlantEstimator(self._nominal, fit.parameters.with_lag_prior(lag).mean)
        new._publish(new.parameters, fit.residuals)
        return new

    def observe(self, transition: Transition) -> None:
        """Take a transition into account."""
        parameters = self.parameters
        residual = self._residual(transition, parameters.mean)
        if float(np.linalg.norm(residual)) > JUMP:
            self.jumps += 1
            return
        if float(np.max(np.abs(transition.inputs))) > EXCITED:
            transitions = (*self._transitions, _Fitted(transition))[-_WINDOW:]
            parameters = self._fitted(parameters, transitions)
            self._transitions = transitions
            residual = self._residual(transition, parameters.mean)
        self._publish(parameters, (*self._fit.residuals, residual)[-_NOISE_WINDOW:])

    def _publish(self, parameters: ParameterDistribution, residuals: tuple[Vector, ...]) -> None:
        scaling, mean = self._scaling, parameters.mean
        estimate = PlantEstimate(
            scaling.lumped(mean),
            significant(scaling.lag(mean)),
            float(np.sqrt(noise_variance(residuals, 0))),
            scaling.constants(np.sqrt(np.diag(parameters.covariance))),
        )
        self._fit = _Fit(parameters, residuals, estimate)

    def _fitted(
        self, parameters: ParameterDistribution, transitions: tuple[_Fitted, ...]
    ) -> ParameterDistribution:
        """Return the fit to all transitions, starting from the parameters so far."""
        prior = 1.0 / PRIOR_DEVIATION**2
        for _ in range(_ITERATIONS):
            before = parameters.mean
            parts = [self._linearised(fitted, before) for fitted in transitions]
            jacobian = np.vstack([part.jacobian for part in parts])
            residuals = [part.residual + part.jacobian @ (before - part.at) for part in parts]
            residual = np.concatenate(residuals)
            variance = noise_variance(residuals, SIZE)
            information = np.diag(prior) + jacobian.T @ jacobian / variance
            right = (self._mean - before) * prior - jacobian.T @ residual / variance
            mean = self._scaling.within(before + np.linalg.solve(information, right))
            covariance = np.asarray(np.linalg.inv(information), dtype=float)
            parameters = ParameterDistribution(mean, covariance)
            if float(np.max(np.abs(mean - before))) < _CONVERGED:
                break
        return parameters

    def _linearised(self, fitted: _Fitted, at: Vector) -> _Linearisation:
        known = fitted.linearisation
        if known is not None:
            moved = np.abs(at - known.at) / PRIOR_DEVIATION
            if float(np.max(moved)) < _STILL_LINEAR:
                return known
        transition = fitted.transition
        residual = self._residual(transition, at)
        found = _Linearisation(at, residual, self._jacobian(transition, at, residual))
        fitted.linearisation = found
        return found

    def _residual(self, transition: Transition, scaled: Vector) -> Vector:
        """Return prediction minus measurement, shape (6,)."""
        durations, inputs = transition.window(self._scaling.lag(scaled))
        constants = self._scaling.constants(scaled)
        predicted = roll_out(transition.start, inputs, durations, constants, _STEP)[-1]
        difference: Vector = predicted - nearer_sign(transition.end, predicted)
        return difference

    def _jacobian(self, transition: Transition, at: Vector, residual: Vector) -> Vector:
        """Return the derivative of the residual by the scaled parameters, shape (6, 5)."""
        columns = []
        for i in range(SIZE):
            scaled = at.copy()
            # Inwards at the longest lag, where the window would begin before the lead.
            step = -_DIFFERENCE if self._scaling.is_highest(at, i) else _DIFFERENCE
            scaled[i] += step
            columns.append((self._residual(transition, scaled) - residual) / step)
        return np.column_stack(columns)


def noise_variance(residuals: Sequence[Vector], fitted: int) -> float:
    """Return the noise variance shown by residuals after `fitted` parameters were fitted."""
    squares = sum(float(r @ r) for r in residuals)
    freedom = max(1, _FREEDOM * len(residuals) - fitted) if residuals else 0
    expected = _EXPECTED_WEIGHT * _EXPECTED_NOISE**2
    return max(LEAST_NOISE**2, (squares + expected) / (freedom + _EXPECTED_WEIGHT))
