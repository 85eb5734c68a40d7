# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimator for noisy poses: extended Kalman filters of state and plant parameters.

One has the paper's model, one has drift. The latter is used while it explains the poses better.
"""

import numpy as np

from sphere_nmpc.estimation.contract import Estimate, PlantEstimate
from sphere_nmpc.estimation.drift_state_estimator import DriftStateEstimator
from sphere_nmpc.estimation.filter_state import FilterState, PoseNoise
from sphere_nmpc.estimation.plant_parameters import (
    ParameterDistribution,
    ParameterScaling,
    significant,
)
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.state_estimator import StateEstimator
from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import ControllerSettings

_LEAST_NOISE = 1e-6
"""Least measurement noise [m, rad] of one part of a pose where the other part is noisy."""
_FORGETTING = 0.98
"""Share of the evidence for drift that remains at the next pose."""
_LARGEST_GAIN = 5.0
"""Largest evidence by one pose, so that an outlier decides nothing."""
_APPEARS = 15.0
"""Logarithm of the evidence above which the model with drift is used, until it is
at its lower bound."""
_EVIDENCE = (-3.0, 40.0)
"""Bounds of the evidence, so that drift that comes or goes is noticed soon."""


class NoisyPoseEstimator:
    """`Estimator` for noisy poses, which are fused with the rotor speeds sent.

    Where learning is off the filter takes the parameters as built as exact.

    Parameters
    ----------
    settings : ControllerSettings
        Pose noise, expected lag, and whether parameters are learnt.
    nominal : LumpedConstants
        Constants of the robot as built.
    sent : SentInputs
        Rotor speeds that were sent.
    prior : ParameterDistribution, optional
        What another estimator has learnt about the parameters.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        nominal: LumpedConstants,
        sent: SentInputs,
        prior: ParameterDistribution | None = None,
    ) -> None:
        self._settings = settings
        self._scaling = ParameterScaling(nominal)
        self._nominal = nominal
        self._learnt = ParameterDistribution.prior(settings.drive_lag) if prior is None else prior
        self._sent = sent
        self._paper = StateEstimator(
            sent, self._scaling, self._parameters_in_use, _pose_noise(settings), FilterState
        )
        self._drifting = self._with_drift()

    @property
    def _filter(self) -> StateEstimator[FilterState] | DriftStateEstimator:
        """The filter in use."""
        return self._drifting if self._drifts else self._paper

    def _with_drift(self) -> DriftStateEstimator:
        """Return a new filter with drift, and begin to collect evidence for it."""
        self._drifts, self._evidence = False, 0.0
        return DriftStateEstimator(
            self._sent, self._scaling, self._parameters_in_use, _pose_noise(self._settings)
        )

    @property
    def newest(self) -> tuple[float, Vector] | None:
        """Control time [s] and state, shape (6,), of the newest pose; None without any."""
        return self._filter.newest

    @property
    def parameters(self) -> ParameterDistribution:
        """Distribution of the parameters as learnt so far."""
        return self._filter.parameters if self._settings.learning else self._learnt

    @property
    def plant(self) -> PlantEstimate:
        """The parameters in use; the noise is the process noise at rest."""
        settings, noise = self._settings, self._filter.disturbance(self._settings.period)
        if not settings.learning:
            return PlantEstimate(self._nominal, settings.drive_lag, noise)
        mean = self._filter.parameters.mean
        lag = significant(self._scaling.lag(mean))
        return PlantEstimate(self._scaling.lumped(mean), lag, noise)

    @property
    def drift(self) -> Drift:
        """Drift after the newest pose, or before the poses were forgotten."""
        return self._filter.drift

    def observe(self, time: float, pose: Vector) -> bool:
        """Fuse a pose; False if it is known already or too old to be inserted."""
        accepted = self._paper.observe(time, pose)
        if self._settings.momentum and self._drifting.observe(time, pose):
            self._compare()
        return accepted

    def _compare(self) -> None:
        """Choose between the models by the likelihood of the newest poses."""
        gain = self._drifting.likelihood - self._paper.likelihood
        gain = float(np.clip(gain, -_LARGEST_GAIN, _LARGEST_GAIN))
        evidence = _FORGETTING * self._evidence + gain
        self._evidence = float(np.clip(evidence, *_EVIDENCE))
        if self._drifts and self._evidence <= _EVIDENCE[0]:
            self._paper.set_parameters(self._drifting.parameters)
            self._drifts = False
        elif not self._drifts and self._evidence > _APPEARS:
            self._drifting.adopt(self._paper)
            self._drifts = True

    def estimate(self, time: float) -> Estimate | None:
        """Return the filter's state predicted to control time `time` [s]."""
        predicted: FilterState | None = self._filter.predict(time)
        if predicted is None:
            return None
        return Estimate(predicted.state, self.plant, predicted.covariance, predicted.drift)

    def change(self, settings: ControllerSettings) -> None:
        """Take over changed settings; estimates that they do not concern are kept."""
        before, self._learnt = self._settings, self.parameters
        self._settings = settings
        if settings.drive_lag != before.drive_lag:
            self._learnt = self._learnt.with_lag_prior(settings.drive_lag)
        if (settings.learning, settings.drive_lag) != (before.learning, before.drive_lag):
            self._paper.set_parameters(self._parameters_in_use)
            self._drifting.set_parameters(self._parameters_in_use)
        self._paper.noise = self._drifting.noise = _pose_noise(settings)
        if settings.momentum != before.momentum:
            self._drifting = self._with_drift()

    def forget(self) -> None:
        """Discard all poses; estimated parameters and drift stay."""
        self._paper.forget()
        self._drifting.forget()

    @property
    def _parameters_in_use(self) -> ParameterDistribution:
        if self._settings.learning:
            return self._learnt
        return ParameterDistribution.known(self._settings.drive_lag)


def _pose_noise(settings: ControllerSettings) -> PoseNoise:
    noise = (settings.pose_position_noise, settings.pose_orientation_noise)
    return PoseNoise(*np.maximum(noise, _LEAST_NOISE))
