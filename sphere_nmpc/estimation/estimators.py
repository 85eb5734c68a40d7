# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The two estimators of state and plant parameters, and the choice between them by the settings.

For exact poses the state is predicted from the newest one, and the parameters are fitted by least
squares. For noisy poses an extended Kalman filter estimates both: one has the paper's model, one
has drift, which is used while it explains the poses better.
"""

from dataclasses import replace

import numpy as np

from sphere_nmpc.estimation.contract import Estimate, Estimator, PlantEstimate
from sphere_nmpc.estimation.drift import Drift
from sphere_nmpc.estimation.filter_state import FilterState, PoseNoise
from sphere_nmpc.estimation.learning import Begin, InLineLearning, LearningBeside
from sphere_nmpc.estimation.plant_parameters import (
    ParameterDistribution,
    ParameterScaling,
    significant,
)
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.state_estimator import DriftStateEstimator, StateEstimator
from sphere_nmpc.estimation.transition import Transition
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import MOMENTUM, Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.worker.contract import Worker

_SHORTEST_TRANSITION, _LONGEST_TRANSITION = 0.2, 2.0
"""Spacing of the poses used for learning [s]; predictions over longer gaps are inaccurate."""
_LEAD = 1.0
"""Time [s] before a transition from which speeds sent are taken into account: weak drives may
have fallen behind since."""
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


def make_estimator(
    settings: ControllerSettings,
    nominal: LumpedConstants,
    sent: SentInputs,
    worker: Worker | None = None,
    previous: Estimator | None = None,
    acceleration: float = float("inf"),
) -> Estimator:
    """Return the estimator for the pose noise in the settings.

    A worker learns beside the control loop; without it is learnt in line. The `previous` estimator
    is kept if it still suits the settings; otherwise its parameters and its newest pose are handed
    over. `acceleration` is the limit of the speeds sent [rad/s^2], which drives may not attain.
    """
    prior = newest = None
    noisy = settings.pose_position_noise > 0.0 or settings.pose_orientation_noise > 0.0
    if previous is not None:
        previous.change(settings)
        if isinstance(previous, NoisyPoseEstimator if noisy else ExactPoseEstimator):
            return previous
        prior, newest = previous.parameters, previous.newest
    made: Estimator
    if noisy:
        made = NoisyPoseEstimator(settings, nominal, sent, prior)
    else:
        made = ExactPoseEstimator(settings, nominal, sent, worker, prior, acceleration)
    if newest is not None:
        made.observe(*newest)
    return made


class ExactPoseEstimator:
    """`Estimator` for poses without noise, of which the newest one is the state.

    Parameters are estimated also where learning is off; they are then not used, but the noise is.

    `prior` is what another estimator has learnt about the parameters; for the other arguments see
    `make_estimator`.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        nominal: LumpedConstants,
        sent: SentInputs,
        worker: Worker | None = None,
        prior: ParameterDistribution | None = None,
        acceleration: float = float("inf"),
    ) -> None:
        self._settings = settings
        self._nominal = nominal
        self._sent = sent
        self._worker = worker
        mean = (ParameterDistribution.prior(settings.drive_lag) if prior is None else prior).mean
        self._acceleration = acceleration
        self._fit = self._learning(mean)
        self._newest: tuple[float, Vector] | None = None
        self._learnt_up_to: tuple[float, Vector] | None = None
        self._awaiting: tuple[float, Vector] | None = None
        self._connected = False

    @property
    def newest(self) -> tuple[float, Vector] | None:
        """Control time [s] and state, shape (6,), of the newest pose; None without any."""
        return self._newest

    @property
    def parameters(self) -> ParameterDistribution:
        """Distribution of the parameters as learnt so far."""
        return self._fit.result.parameters

    @property
    def plant(self) -> PlantEstimate:
        """The parameters in use, with the noise and the standard deviations of the last fit."""
        learnt = self._fit.result.plant
        if self._settings.learning:
            return learnt
        return PlantEstimate(
            self._nominal, self._settings.drive_lag, learnt.noise, learnt.deviations
        )

    @property
    def momentum(self) -> Vector:
        """Momentum of the last fit."""
        return self._fit.result.drift.momentum

    @property
    def disturbance(self) -> Disturbance:
        """Disturbance of the last fit."""
        return self._fit.result.drift.disturbance

    def observe(self, time: float, pose: Vector) -> bool:
        """Take a pose; False if it is not newer than the newest."""
        if self._newest is not None and time <= self._newest[0]:
            return False
        self._newest = (time, pose)
        return True

    def estimate(self, time: float) -> Estimate | None:
        """Return the state predicted from the newest pose to control time `time` [s]."""
        if self._newest is None:
            return None
        stamp, pose = self._newest
        self._learn(stamp, pose)
        plant = self.plant
        # Because of the lag, inputs sent before the pose was measured have yet to take effect:
        # relative to the inputs the pose is older by the lag.
        constants, step = plant.constants.as_array(), self._settings.longest_step
        drift = self._drift(stamp, plant.lag, constants)
        state, disturbance = np.concatenate((pose, drift.momentum)), drift.disturbance
        state = self._sent.predict(
            state, stamp - plant.lag, time, constants, step, disturbance
        )
        return Estimate(state, plant, disturbance=disturbance)

    def change(self, settings: ControllerSettings) -> None:
        """Take over changed settings; estimates that they do not concern are kept."""
        before, self._settings = self._settings, settings
        if settings.momentum != before.momentum:
            self._fit = self._learning(self._fit.result.parameters.mean)
        if settings.drive_lag != before.drive_lag:
            # Transitions seen so far would pull the lag back to its last estimate.
            self._fit.restart(settings.drive_lag)

    def forget(self) -> None:
        """Discard the newest pose and the transition that has begun."""
        self._newest = self._learnt_up_to = self._awaiting = None
        self._connected = False

    def _learning(self, mean: Vector) -> InLineLearning | LearningBeside:
        """Return new learning with this prior mean of the scaled parameters, shape (5,)."""
        begin = Begin(self._nominal, mean, self._settings.momentum, self._acceleration)
        if self._worker is None:
            return InLineLearning(begin)
        return LearningBeside(begin, self._worker)

    def _drift(self, stamp: float, lag: float, constants: Vector) -> Drift:
        """Return the drift at the newest pose, measured at `stamp` [s]."""
        result = self._fit.result
        # A drift of zero stays zero; predicting it over a fit's age costs half a tick at 500 Hz.
        if result.drift.is_zero or result.end is None or not self._connected:
            return result.drift
        known, pose = result.end
        state = self._sent.predict(
            np.concatenate((pose, result.drift.momentum)), known - lag, stamp - lag, constants,
            self._settings.longest_step, result.drift.disturbance,
        )
        return replace(result.drift, momentum=state[MOMENTUM].copy())

    def _learn(self, time: float, pose: Vector) -> None:
        """Fit the parameters to the motion since the last pose used for it."""
        now = time
        time, pose = self._awaiting or (time, pose)
        last = self._learnt_up_to
        if last is not None and time - last[0] < _SHORTEST_TRANSITION:
            self._sent.collect(time)
            return
        # Rotor speeds measured until then may still be on their way.
        self._awaiting = (time, pose) if self._sent.is_pending(time, now) else None
        if self._awaiting is not None:
            return
        self._learnt_up_to = (time, pose)
        if last is None or time - last[0] > _LONGEST_TRANSITION:
            self._connected = False
            return
        since, start = last
        pieces = self._sent.pieces(since - _LEAD, time)
        transition = Transition(start, pose, *pieces, _LEAD)
        self._connected = self._fit.observe(transition, time, self._connected)


class NoisyPoseEstimator:
    """`Estimator` for noisy poses, which are fused with the rotor speeds sent.

    Where learning is off the filter takes the parameters as built as exact.

    The arguments are those of `ExactPoseEstimator`.
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
    def momentum(self) -> Vector:
        """Momentum after the newest pose, or before the poses were forgotten."""
        return self._filter.drift.momentum

    @property
    def disturbance(self) -> Disturbance:
        """Disturbance after the newest pose, or before the poses were forgotten."""
        return self._filter.drift.disturbance

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
        drift = predicted.drift
        state = np.concatenate((predicted.state, drift.momentum))
        return Estimate(state, self.plant, predicted.covariance, drift.disturbance)

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
