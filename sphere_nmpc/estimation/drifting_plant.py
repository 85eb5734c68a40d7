# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Choice between the paper's model and the one with drift, by what explains the motion better.

Without evidence of drift the estimate is that of `PlantEstimator`, unchanged.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.estimation.contract import PlantEstimate
from sphere_nmpc.estimation.drift import NO_DRIFT, Drift
from sphere_nmpc.estimation.drift_fit import EXPLAINED, DriftFit
from sphere_nmpc.estimation.plant_estimator import EXCITED, PlantEstimator, shown_noise
from sphere_nmpc.estimation.plant_parameters import (
    LONGEST_LAG,
    ParameterDistribution,
    ParameterScaling,
    significant,
)
from sphere_nmpc.estimation.transition import Transition
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector

APPEARS = 20.0
"""Logarithm of the evidence for drift above which the model with drift is used ..."""
VANISHES = 3.0
"""... and of the likelihood gained by it below which it is given up."""

_COMPARED = 6
"""Transitions whose predictions with and without drift are compared."""

_MISLED = 20.0
"""Logarithm of the likelihood lost by drift above which its fit begins anew."""
_CERTAIN = 60.0
"""The same above which nothing else is asked where errors are small otherwise."""
_MOST_PUSHES, _PUSHES_OVER = 3, 10
"""More pushes than the first number, within the second one of transitions, are no pushes: the
motion differs from the model otherwise, as where a drive is weaker than assumed or the shell
slips. One push may count twice."""
_LEAST_MOMENTUM, _LEAST_TORQUE = 0.3, 1.0
"""Momentum [rad/s] and slope or imbalance [rad/s^2: 0.04 degrees, 0.2 mm] below which drift is not
used: what slip leaves behind is of this size, and the torque of a real one soon makes more."""
_SAME_SHARE = 0.01
"""Difference of the share of the acceleration limit that the drives attain, up to which the fit of
drift is kept."""
_CONFIRMED = 3
"""Transitions that drift has to predict better where slip or process noise blur them."""


@dataclass(frozen=True, eq=False)
class DriftingPlant:
    """Result of an update.

    Attributes
    ----------
    plant : PlantEstimate
        Parameters of the plant.
    parameters : ParameterDistribution
        Distribution of the scaled parameters.
    drift : Drift
        At the end of the newest transition; `NO_DRIFT` without evidence.
    end : tuple of float and ndarray, or None
        Control time [s] and pose, shape (6,), of that end; None before the first transition.
    """

    plant: PlantEstimate
    parameters: ParameterDistribution
    drift: Drift = NO_DRIFT
    end: tuple[float, Vector] | None = None


class DriftingPlantEstimator:
    """Estimator of the plant's parameters, and of drift where there is evidence of any.

    The result of an update is published as a whole when the update is complete: another thread
    may read `result` at any time. `mean`, shape (5,), is that of the prior in scaled parameters,
    `momentum` says whether drift is looked for, and `acceleration` is the limit of the speeds sent
    [rad/s^2], which the drives may not attain; by default they do.
    """

    def __init__(
        self,
        nominal: LumpedConstants,
        mean: Vector,
        momentum: bool,
        acceleration: float = np.inf,
    ) -> None:
        self._nominal = nominal
        self._scaling = ParameterScaling(nominal)
        self._acceleration = acceleration
        self._paper = PlantEstimator(nominal, mean, acceleration)
        self._drifting = DriftFit(nominal, mean)
        self._driven_share = 1.0
        self._interrupted = False
        self._momentum = momentum
        self._drifts = False
        self._innovations: deque[tuple[float, float]] = deque(maxlen=_COMPARED)
        self._pushed: deque[bool] = deque(maxlen=_PUSHES_OVER)
        self.result = DriftingPlant(self._paper.estimate, self._paper.parameters)
        """Estimate after the last complete update."""

    def restarted(self, lag: float) -> "DriftingPlantEstimator":
        """Return a new estimator with the present constants and another lag [s] as prior."""
        new = DriftingPlantEstimator(
            self._nominal, self._paper.parameters.mean, self._momentum, self._acceleration
        )
        new._paper = self._paper.restarted(lag)
        new._drifting = self._drifting.restarted(lag)
        new._driven_share = self._driven_share
        new._interrupted = self._interrupted
        new._drifts = self._drifts
        new._publish(self.result.end)
        return new

    def observe(self, transition: Transition, time: float, connected: bool) -> None:
        """Take a transition that ends at control time `time` [s] into account.

        `connected` says whether it starts where the last one ended.
        """
        transition = transition.straightened()
        if self._momentum:
            self._compare(transition, connected)
        else:
            self._paper.observe(transition)
        self._publish((time, transition.end))

    def _compare(self, transition: Transition, connected: bool) -> None:
        """Fit both models where they are in use or may be, and choose between them."""
        known = self._parameters.mean
        if not self._drifts:
            self._paper.observe(transition)
            if abs(self._paper.share - self._driven_share) > _SAME_SHARE:
                # Its transitions are of drives that attain another acceleration.
                self._driven_share = self._paper.share
                self._drifting = DriftFit(self._nominal, self._paper.parameters.mean)
            if self._paper.saturated(transition):
                # What the rotors lack is known to a few per cent only, which drift would explain.
                self._interrupted = True
                return
        connected = connected and not self._interrupted
        self._interrupted = False
        drifting = self._drifting
        transition = transition.driven(self._driven_share * self._acceleration, LONGEST_LAG)
        without = drifting.error_without_drift(transition, known)
        explained = not self._drifts and without < EXPLAINED
        if explained and np.max(np.abs(transition.inputs)) < EXCITED:
            # At rest, where all remains as it was.
            return
        drifting.observe(transition, connected, explained)
        if explained and drifting.innovation < EXPLAINED:
            return
        self._innovations.append((without, drifting.innovation))
        self._pushed.append(drifting.newest_was_pushed)
        gain, occam = drifting.evidence(self._parameters.mean)
        if self._drifts:
            self._drifts = (
                gain > VANISHES and self._predicts_better() and not self._is_something_else
            )
            if not self._drifts:
                self._paper = PlantEstimator(
                    self._nominal, drifting.parameters.mean, self._acceleration,
                    self._driven_share,
                )
        elif gain < -_MISLED:
            # As after slip, which the prior of older transitions does not forget.
            self._drifting = DriftFit(self._nominal, self._paper.parameters.mean)
        elif self._is_convincing(gain - occam):
            self._drifts = True
            self._innovations.clear()

    @property
    def _parameters(self) -> ParameterDistribution:
        return (self._drifting if self._drifts else self._paper).parameters

    def _is_convincing(self, evidence: float) -> bool:
        """Return whether the evidence for drift suffices.

        A push, or much evidence, suffices at once where errors are small otherwise; else drift
        must have improved predictions, of several transitions where slip or noise blur them.
        """
        if evidence < APPEARS or self._is_something_else or not self._is_large:
            return False
        if self._drifting.clear and (self._drifting.pushed or evidence > _CERTAIN):
            return True
        newest = list(self._innovations)[-1 if self._drifting.clear else -_CONFIRMED :]
        return all(found < 0.5 * without for without, found in newest)

    @property
    def _is_something_else(self) -> bool:
        """Whether there are more pushes than anybody pushes."""
        return sum(self._pushed) > _MOST_PUSHES

    @property
    def _is_large(self) -> bool:
        """Whether drift is large enough to be used."""
        drift = self._drifting.drift
        torque = max(np.linalg.norm(drift.slope), np.linalg.norm(drift.imbalance))
        return bool(
            np.linalg.norm(drift.momentum) > _LEAST_MOMENTUM or torque > _LEAST_TORQUE
        )

    def _predicts_better(self) -> bool:
        """Return whether drift has improved the predictions."""
        errors = np.square(self._innovations).sum(axis=0)
        return len(self._innovations) < _COMPARED or bool(errors[1] < errors[0])

    def _publish(self, end: tuple[float, Vector] | None) -> None:
        if not self._drifts:
            paper = self._paper
            self.result = DriftingPlant(paper.estimate, paper.parameters, NO_DRIFT, end)
            return
        parameters, scaling = self._drifting.parameters, self._scaling
        estimate = PlantEstimate(
            scaling.lumped(parameters.mean),
            significant(scaling.lag(parameters.mean)),
            shown_noise(self._drifting.errors),
            scaling.constants(np.sqrt(np.diag(parameters.covariance))),
            self._paper.estimate.acceleration,
        )
        self.result = DriftingPlant(estimate, parameters, self._drifting.drift, end)
