# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Moving-horizon estimate of momentum, slope and imbalance together with the plant's parameters.

The newest transitions are fitted by Gauss-Newton least squares; the older ones are summed up in a
Gaussian prior, so that nothing learnt is lost at rest. A transition that only a jump of the
momentum explains was pushed; one that not even a jump explains (the robot was carried, or slipped)
is left out.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from sphere_nmpc.estimation.drift import (
    Drift,
    propagate_with_drift,
    state_rates_with_drift,
)
from sphere_nmpc.estimation.drift_equations import (
    COMMON,
    ERROR,
    IMBALANCE,
    KNOT,
    PARAMETERS,
    Gaussian,
    NormalEquations,
    Prediction,
    Weights,
    knot,
)
from sphere_nmpc.estimation.plant_parameters import (
    LAG,
    LAG_PRIOR,
    PRIOR_DEVIATION,
    ParameterDistribution,
    ParameterScaling,
)
from sphere_nmpc.estimation.transition import Transition
from sphere_nmpc.model.error_state import error_between
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import POSE, Vector, angle_error, without_momentum
from sphere_nmpc.solver.roll_out import roll_out

_WINDOW = 12
"""Transitions fitted together."""
_STEP = 0.05
"""Longest integration step of the prediction [s]."""
_ITERATIONS = 6
"""Gauss-Newton iterations for each fit at most."""
_REST_NOISE = 2e-5
"""Standard deviation of the prediction error at rest [m, rad] ..."""
_ROLLING_NOISE = 1e-3
"""... and of a rolling sphere, over the angle rolled [rad]."""
_PRIOR = np.array([10.0, 10.0, 10.0, 30.0, 30.0, 1.0, 15.0, 15.0])
"""Prior standard deviations of imbalance [rad/s^2], momentum [rad/s] and slope [rad/s^2]."""
_WALK = np.array([0.05, 0.05, 0.05, 0.1, 0.1])
"""Random walk of momentum [rad/s per sqrt(s)] and slope [rad/s^2 per sqrt(s)]."""
_PUSH = np.array([50.0, 50.0, 1.0, 5.0, 5.0])
"""Standard deviations of their jumps at a push, or while the sphere was carried."""
_FORGOTTEN = np.array([1e-4] * 5 + [0.01] * 3)
"""Random walk of the common unknowns [their units per sqrt(s)]."""
_SCALE = np.concatenate((PRIOR_DEVIATION, np.full(3, 30.0), np.full(3, 30.0), np.full(2, 30.0)))
"""Scale of changes of the unknowns."""
_STILL_LINEAR = 3e-3
"""Change in that scale up to which a linearisation is kept."""
_LARGEST = np.array([50.0, 300.0, 300.0, 300.0, 200.0, 200.0])
"""Bounds of imbalance [rad/s^2], momentum [rad/s] and slope [rad/s^2], so that no fit diverges."""
_CONVERGED = 3e-4
"""Change in that scale at which the iteration ends."""
_SURPRISE = 100.0
"""Squared error of a transition over its variance above which it is not due to noise."""
EXPLAINED = 2e-5
"""Prediction error [m, rad] below which a transition needs no fit: the least torque that is used
causes ten times as much within a sample."""
_NOTICEABLE = 5e-3
"""Prediction error [m, rad] below which no push or slip is looked for."""
_EXPLAINED = 0.1
"""Share of the error that may remain where a push explains a transition."""
_CLEAR = 5.0
"""Inflation of the noise below which a push is told from slip and process noise."""
_ROBUST = 25.0
"""Squared error over its variance above which a transition counts less."""


@dataclass(eq=False)
class _Step:
    """A transition of the window."""

    transition: Transition
    noise: float
    """Standard deviation of its prediction error, without inflation [m, rad]."""
    pushed: bool = False
    left_out: bool = False
    prediction: Prediction | None = None
    error: Vector = field(default_factory=lambda: np.zeros(ERROR))
    """Prediction error after the last fit [m, rad], shape (5,)."""
    innovation: float = 0.0
    """Norm of its prediction error before it was fitted [m, rad]."""

    @property
    def squared(self) -> float:
        """Squared error of the last fit over the variance without inflation."""
        return float(self.error @ self.error) / self.noise**2


class DriftFit:
    """Fit of momentum, slope, imbalance and the plant's parameters to the newest transitions.

    `mean`, shape (5,), is that of the prior in scaled parameters.
    """

    def __init__(self, nominal: LumpedConstants, mean: Vector) -> None:
        self._nominal = nominal
        self._scaling = ParameterScaling(nominal)
        deviations = np.concatenate((PRIOR_DEVIATION, _PRIOR))
        self._steps: list[_Step]
        self._restart(Gaussian(np.concatenate((mean, np.zeros(8))), np.diag(deviations**-2.0)))
        self._inflation = 1.0

    @property
    def parameters(self) -> ParameterDistribution:
        """Distribution of the scaled parameters."""
        covariance = np.asarray(np.linalg.inv(self._equations.information), dtype=float)
        mean = self._unknowns[PARAMETERS].copy()
        return ParameterDistribution(mean, covariance[PARAMETERS, PARAMETERS])

    @property
    def drift(self) -> Drift:
        """Drift at the end of the newest transition."""
        return self._drift_at(self._unknowns[knot(len(self._steps))], self._unknowns[IMBALANCE])

    @property
    def errors(self) -> list[Vector]:
        """Prediction errors of the window without pushed and left out transitions, (5,) each.

        Of the state: a rotation by a small angle moves its quaternion half as far.
        """
        kept = [step for step in self._steps if not (step.pushed or step.left_out)]
        return [step.error * np.array([1.0, 1.0, 0.5, 0.5, 0.5]) for step in kept]

    def restarted(self, lag: float) -> "DriftFit":
        """Return a new fit with the present constants and drift, and another lag [s] as prior."""
        known = self._summary
        covariance = np.asarray(np.linalg.inv(known.information), dtype=float)
        mean = known.mean.copy()
        parameters = ParameterDistribution(mean[PARAMETERS], covariance[PARAMETERS, PARAMETERS])
        mean[PARAMETERS] = parameters.with_lag_prior(lag).mean
        covariance[LAG, :] = covariance[:, LAG] = 0.0
        covariance[LAG, LAG] = PRIOR_DEVIATION[LAG] ** 2
        new = DriftFit(self._nominal, mean[PARAMETERS])
        new._restart(Gaussian(mean, np.linalg.inv(covariance)))
        return new

    def _restart(self, known: Gaussian) -> None:
        """Begin an empty window with a distribution of common unknowns and first knot."""
        self._prior = self._summary = known
        self._unknowns = known.mean
        self._steps = []
        self._equations = NormalEquations(self._unknowns, known)

    @property
    def innovation(self) -> float:
        """Norm of the prediction error of the newest transition before it was fitted [m, rad]."""
        return self._steps[-1].innovation

    @property
    def clear(self) -> bool:
        """Whether other causes of errors than drift are small."""
        return self._inflation < _CLEAR

    @property
    def pushed(self) -> bool:
        """Whether one of the two newest transitions was pushed."""
        return any(step.pushed for step in self._steps[-2:])

    @property
    def newest_was_pushed(self) -> bool:
        """Whether the newest transition is explained by a push, or not at all."""
        return bool(self._steps) and (self._steps[-1].pushed or self._steps[-1].left_out)

    def evidence(self, paper: Vector) -> tuple[float, float]:
        """Return how much better the window is explained with drift than without.

        That is the logarithm of the ratio of likelihoods, the level of the noise being unknown,
        and that of the share of the drifts that would have explained the window as well. `paper`,
        shape (5,), are the scaled parameters of the model without drift.
        """
        counted = [step for step in self._steps if not step.left_out]
        without = sum(
            (self.error_without_drift(step.transition, paper) / step.noise) ** 2
            for step in counted
        )
        with_drift = sum(step.squared for step in counted)
        without, with_drift = without / self._inflation, with_drift / self._inflation
        freedom = ERROR * (len(counted) + 1)
        ratio = (without + ERROR) / (with_drift + self._equations.cost + ERROR)
        gain = 0.5 * freedom * np.log(ratio)
        return float(gain), self._equations.occam()

    def observe(
        self, transition: Transition, connected: bool = True, explained: bool = False
    ) -> None:
        """Take a transition into account.

        `connected` says whether it starts where the last one ended, `explained` whether the model
        without drift predicts its end. One that is predicted with drift, too, is not fitted until
        a later one is.
        """
        try:
            self._take(transition, connected, explained)
        except Exception:
            # The momentum at the end of this transition remains unknown.
            self._restart(_forgotten(self._summary, np.zeros(COMMON), _PUSH**2))
            raise

    def _take(self, transition: Transition, connected: bool, explained: bool) -> None:
        if not connected:
            self._disconnect()
        while len(self._steps) >= _WINDOW:
            self._slide()
        step = _Step(transition, self._noise(transition))
        last = self._unknowns[knot(len(self._steps))]
        prediction = self._predicted(transition, np.concatenate((self._unknowns[:COMMON], last)))
        self._steps.append(step)
        self._unknowns = np.concatenate((self._unknowns, prediction.after))
        surprise = step.innovation = float(np.linalg.norm(prediction.error))
        step.prediction = prediction
        if explained and surprise < EXPLAINED:
            return
        before = self._unknowns
        self._fit()
        noticeable = min(_NOTICEABLE, 50.0 * step.noise)
        if surprise > noticeable and self._is_surprising(step):
            step.pushed = True
            self._fit_again(before)
            # Also false where the fit did not end in numbers.
            if not float(np.linalg.norm(step.error)) < _EXPLAINED * surprise:
                step.pushed, step.left_out = False, True
                self._fit_again(before)
        self._adapt()
        self._summary = self._equations.marginal(len(self._steps))

    def _fit_again(self, unknowns: Vector) -> None:
        """Fit from other unknowns, after another explanation of the newest transition."""
        self._unknowns = unknowns
        for step in self._steps:
            step.error = np.zeros(ERROR)
        self._fit()

    def _is_surprising(self, step: _Step) -> bool:
        """Return whether the newest transition or the change before it is not due to noise."""
        index = len(self._steps) - 1
        found = step.squared / self._inflation
        if index > 0 and not step.pushed:
            before = self._steps[index - 1]
            if before.prediction is not None and not (before.pushed or before.left_out):
                at = np.r_[0:COMMON, knot(index - 1)]
                after = before.prediction.moved_to(self._unknowns[at])[ERROR:]
                change = self._unknowns[knot(index)] - after
                found += float(np.sum((change / _WALK) ** 2)) / before.transition.duration
        return not found < _SURPRISE

    def _fit(self) -> None:
        for _ in range(_ITERATIONS):
            step = self._built().step()
            moved = self._unknowns + step
            moved[PARAMETERS] = self._scaling.within(moved[PARAMETERS])
            moved[IMBALANCE] = np.clip(moved[IMBALANCE], -_LARGEST[0], _LARGEST[0])
            knots = moved[COMMON:].reshape(-1, KNOT)
            moved[COMMON:] = np.clip(knots, -_LARGEST[1:], _LARGEST[1:]).ravel()
            change = np.abs(moved - self._unknowns)
            self._unknowns = moved
            common = np.max(change[:COMMON] / _SCALE[:COMMON])
            changed = np.max(change[COMMON:].reshape(-1, KNOT) / _SCALE[COMMON:])
            if max(common, changed) < _CONVERGED * self._tolerance:
                break
        self._equations = self._built()

    def _built(self, steps: int | None = None) -> NormalEquations:
        """Return the normal equations of the first `steps` transitions; all by default."""
        count = len(self._steps) if steps is None else steps
        equations = NormalEquations(self._unknowns[: COMMON + KNOT * (count + 1)], self._prior)
        for index, step in enumerate(self._steps[:count]):
            at = self._unknowns[np.r_[0:COMMON, knot(index)]]
            known = step.prediction
            if known is None or self._left(known, at):
                known = step.prediction = self._predicted(step.transition, at)
            step.error = equations.add(index, known, self._weights(index))
        return equations

    @property
    def _tolerance(self) -> float:
        """Factor on the accuracy of the fit: with more noise less is enough."""
        return min(30.0, float(np.sqrt(self._inflation)))

    def _left(self, known: Prediction, at: Vector) -> bool:
        """Return whether the unknowns have left the range of a linearisation."""
        return bool(np.max(np.abs(at - known.at) / _SCALE) > _STILL_LINEAR * self._tolerance)

    def _weights(self, index: int) -> Weights:
        step, newest = self._steps[index], index + 1 == len(self._steps)
        following = step if newest else self._steps[index + 1]
        loose = step.pushed or step.left_out or (following.pushed and not newest)
        variance = _PUSH**2 if loose else _WALK**2 * step.transition.duration
        if step.left_out:
            return Weights(0.0, 1.0 / variance)
        squared = step.squared / self._inflation
        weight = min(1.0, _ROBUST / squared) if squared > 0.0 and not step.pushed else 1.0
        error = weight / (self._inflation * step.noise**2)
        # A push at an unknown instant: half of the jump is the best guess for the average.
        coupled = (2.0 / _PUSH) ** 2 if step.pushed and newest else None
        return Weights(error, 1.0 / variance, coupled)

    def _slide(self) -> None:
        """Sum up the oldest transition in the prior."""
        duration = self._steps[0].transition.duration
        marginal = self._built(1).marginal(1)
        self._prior = _forgotten(marginal, _FORGOTTEN**2 * duration)
        kept = np.r_[0:COMMON, COMMON + KNOT : self._unknowns.size]
        self._unknowns = self._unknowns[kept]
        del self._steps[0]

    def _disconnect(self) -> None:
        """Sum up the whole window; what happened since is unknown."""
        if self._steps:
            marginal = self._built().marginal(len(self._steps))
            self._restart(_forgotten(marginal, np.zeros(COMMON), _PUSH**2))

    def _adapt(self) -> None:
        """Adapt the inflation of the noise to the errors of the fit."""
        squares = [step.squared for step in self._steps if not step.pushed]
        count = ERROR * len(squares)
        total = sum(min(square, _SURPRISE * self._inflation) for square in squares)
        self._inflation = max(1.0, (2.0 * total + 10.0) / (count + 10.0))

    def _noise(self, transition: Transition) -> float:
        turned = angle_error(transition.start, transition.end)
        ramp = float(np.max(np.ptp(transition.inputs, axis=0)))
        turned += ramp * self._scaling.constants(self._unknowns)[1] * transition.duration
        return float(np.hypot(_REST_NOISE, _ROLLING_NOISE * turned))

    def error_without_drift(self, transition: Transition, scaled: Vector) -> float:
        """Return the norm of the prediction error without drift [m, rad].

        `scaled` are the scaled parameters, shape (5,).
        """
        durations, speeds = transition.window(self._scaling.lag(scaled))
        constants = self._scaling.constants(scaled)
        start = without_momentum(transition.start)
        end = roll_out(start, speeds, durations, constants, _STEP)[-1, POSE]
        return float(np.linalg.norm(error_between(transition.end, end)))

    def _predicted(self, transition: Transition, at: Vector) -> Prediction:
        scaled = at[PARAMETERS]
        constants = self._scaling.constants(scaled)
        drift = self._drift_at(at[COMMON:], at[IMBALANCE])
        durations, speeds = transition.window(self._scaling.lag(scaled))
        end = propagate_with_drift(transition.start, drift, durations, speeds, constants, _STEP)
        by_unknowns = np.zeros((ERROR + KNOT, COMMON + KNOT))
        by_unknowns[:8, :4] = end.by_constants * self._scaling.slopes()
        # A longer lag adds motion before the transition and takes motion from its end.
        begun = state_rates_with_drift(transition.start, drift, speeds[0], constants)
        by_unknowns[:8, LAG] = LAG_PRIOR * (end.by_start[:, :5] @ begun)
        moved = replace(drift, momentum=end.momentum)
        ended = state_rates_with_drift(end.state, moved, speeds[-1], constants)
        by_unknowns[:5, LAG] -= LAG_PRIOR * ended
        by_unknowns[:8, IMBALANCE] = end.by_torques[:, 2:]
        by_unknowns[:8, COMMON : COMMON + 3] = end.by_start[:, 5:]
        by_unknowns[:8, COMMON + 3 :] = end.by_torques[:, :2]
        by_unknowns[8:, COMMON + 3 :] = np.eye(2)
        after = np.concatenate((end.momentum, drift.slope))
        return Prediction(at, error_between(transition.end, end.state), after, by_unknowns)

    @staticmethod
    def _drift_at(values: Vector, imbalance: Vector) -> Drift:
        return Drift(values[:3].copy(), values[3:].copy(), imbalance.copy())


def _forgotten(known: Gaussian, common: Vector, knot_variances: Vector | None = None) -> Gaussian:
    """Return a distribution with variances added to the common unknowns and to the knot's."""
    added = np.zeros(KNOT) if knot_variances is None else knot_variances
    covariance = np.linalg.inv(known.information) + np.diag(np.concatenate((common, added)))
    return Gaussian(known.mean, np.linalg.inv(covariance))
