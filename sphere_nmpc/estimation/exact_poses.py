# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimator for exact poses: prediction from the newest one, parameters by least squares."""

from sphere_nmpc.estimation.contract import Estimate, PlantEstimate
from sphere_nmpc.estimation.learning_task import Begin
from sphere_nmpc.estimation.plant_learning import InLineLearning, LearningBeside
from sphere_nmpc.estimation.plant_parameters import ParameterDistribution
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.transition import Transition
from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.worker.contract import Worker

_SHORTEST_TRANSITION, _LONGEST_TRANSITION = 0.2, 2.0
"""Spacing of the poses used for learning [s]; predictions over longer gaps are inaccurate."""
_LEAD = 1.0
"""Time [s] before a transition from which speeds sent are taken into account: weak drives may
have fallen behind since."""


class ExactPoseEstimator:
    """`Estimator` for poses without noise, of which the newest one is the state.

    Parameters are estimated also where learning is off; they are then not used, but the noise is.

    Parameters
    ----------
    settings : ControllerSettings
        Expected lag, integration step, and whether learnt parameters are used.
    nominal : LumpedConstants
        Constants of the robot as built.
    sent : SentInputs
        Rotor speeds that were sent.
    worker : Worker, optional
        Fits the parameters; by default they are fitted in line, so that results repeat.
    prior : ParameterDistribution, optional
        What another estimator has learnt about the parameters.
    acceleration : float, optional
        Limit of the speeds sent [rad/s^2], which the drives may not attain; by default they do.
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
    def drift(self) -> Drift:
        """Drift of the last fit."""
        return self._fit.result.drift

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
        state, drift = self._sent.predict_with_drift(
            pose, drift, stamp - plant.lag, time, constants, step
        )
        return Estimate(state, plant, drift=drift)

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
        _, drift = self._sent.predict_with_drift(
            pose, result.drift, known - lag, stamp - lag, constants,
            self._settings.longest_step,
        )
        return drift

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
