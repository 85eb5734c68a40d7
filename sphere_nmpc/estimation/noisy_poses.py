# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimator for noisy poses: an extended Kalman filter of state and plant parameters."""

import numpy as np

from sphere_nmpc.estimation.contract import Estimate, PlantEstimate
from sphere_nmpc.estimation.filter_state import FilterState, PoseNoise
from sphere_nmpc.estimation.plant_parameters import (
    ParameterDistribution,
    ParameterScaling,
    significant,
)
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.state_estimator import StateEstimator
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import ControllerSettings

_LEAST_NOISE = 1e-6
"""Least measurement noise [m, rad] of one part of a pose where the other part is noisy."""


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
        self._filter = StateEstimator(
            sent, self._scaling, self._parameters_in_use, _pose_noise(settings)
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

    def observe(self, time: float, pose: Vector) -> bool:
        """Fuse a pose; False if it is known already or too old to be inserted."""
        return self._filter.observe(time, pose)

    def estimate(self, time: float) -> Estimate | None:
        """Return the filter's state predicted to control time `time` [s]."""
        predicted: FilterState | None = self._filter.predict(time)
        if predicted is None:
            return None
        return Estimate(predicted.state, self.plant, predicted.covariance)

    def change(self, settings: ControllerSettings) -> None:
        """Take over changed settings; estimates that they do not concern are kept."""
        before, self._learnt = self._settings, self.parameters
        self._settings = settings
        if settings.drive_lag != before.drive_lag:
            self._learnt = self._learnt.with_lag_prior(settings.drive_lag)
        if (settings.learning, settings.drive_lag) != (before.learning, before.drive_lag):
            self._filter.set_parameters(self._parameters_in_use)
        self._filter.noise = _pose_noise(settings)

    def forget(self) -> None:
        """Discard all poses; estimated parameters stay."""
        self._filter.forget()

    @property
    def _parameters_in_use(self) -> ParameterDistribution:
        if self._settings.learning:
            return self._learnt
        return ParameterDistribution.known(self._settings.drive_lag)


def _pose_noise(settings: ControllerSettings) -> PoseNoise:
    noise = (settings.pose_position_noise, settings.pose_orientation_noise)
    return PoseNoise(*np.maximum(noise, _LEAST_NOISE))
