# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Kalman filter of the state over the poses since the last result of the moving horizon.

The plant's parameters, slope and imbalance are those of the result: what they are off by is taken
into account, but not estimated (a Schmidt-Kalman filter).
"""

import numpy as np

from sphere_nmpc.estimation.estimate import PlantEstimate
from sphere_nmpc.estimation.events import noise_variance
from sphere_nmpc.estimation.motion import pose_rate
from sphere_nmpc.estimation.posterior import Posterior
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.unknowns import (
    CONSTANTS,
    DISTURBANCE,
    IMBALANCE,
    KNOT,
    LOCAL,
    MOMENTUM_ERROR,
    POSE_ERROR,
    SLOPE_ERROR,
    Scaling,
)
from sphere_nmpc.model.disturbance import UNDISTURBED
from sphere_nmpc.model.error_state import ERROR_SIZE, apply_error, error_between
from sphere_nmpc.model.state import MOMENTUM, POSE, STATE_SIZE, Vector
from sphere_nmpc.solver.roll_out import propagate


class Tracker:
    """State at the newest pose; `poses` are those known so far, the first one of the result.

    Exact poses are the state themselves. Of noisy ones outliers are left out, until there are
    several in a row.
    """

    def __init__(
        self,
        result: Posterior,
        plant: PlantEstimate,
        poses: list[tuple[float, Vector]],
        sent: SentInputs,
        pose_deviations: Vector,
        scaling: Scaling,
        max_step: float,
        noisy: bool,
    ) -> None:
        self._sent, self._scaling, self._max_step, self._noisy = sent, scaling, max_step, noisy
        self._lag, self._constants = plant.lag, plant.constants.as_array()
        self._pose_deviations, self._pose_noise = pose_deviations, result.pose_noise
        self._noise_scale = result.scale
        self.disturbance = result.slope_and_imbalance
        """Slope and imbalance that it predicts with."""
        self._time, self._state = result.time, result.knot[:STATE_SIZE].copy()
        self._covariance = result.covariance.copy()
        """That of the local unknowns, shape (19, 19)."""
        zero = DISTURBANCE if result.undisturbed else DISTURBANCE[5:]
        if not result.unbalanced:
            self._covariance[zero, :] = self._covariance[:, zero] = 0.0
        if result.undisturbed:
            self._state[MOMENTUM] = 0.0
        self.outliers: set[float] = set()
        """Times of poses that were left out [s]."""
        self._in_a_row: list[float] = []
        for stamp, pose in poses:
            if stamp > self._time:
                self.observe(stamp, pose)

    def observe(self, time: float, pose: Vector) -> None:
        """Fuse a pose, shape (6,), measured at control time `time` [s]."""
        if not np.isfinite(self._time):
            self._time, self._state = time, np.concatenate((pose, self._state[MOMENTUM]))
            self._covariance[:5, :5] = self._measured()
            return
        if not self._noisy:
            moved = self._state
            if self.disturbance is not UNDISTURBED:
                moved, _ = self.predict(time - self._lag)
            self._time, self._state = time, np.concatenate((pose, moved[MOMENTUM]))
            return
        self._state, self._covariance = self._moved(time - self._lag)
        self._time = time
        innovation = error_between(self._state[POSE], pose)
        measured = self._measured()
        expected = self._covariance[:5, :5] + measured
        square = float(innovation @ np.linalg.solve(expected, innovation))
        if square < self._scaling.numbers.improbable:
            known = self._covariance[:5]
            gain = np.linalg.solve(expected, known[:, :ERROR_SIZE]).T
            self._state = apply_error(self._state, gain @ innovation)
            self._covariance[:ERROR_SIZE] -= gain @ known
            self._covariance[:, :ERROR_SIZE] = self._covariance[:ERROR_SIZE].T
            self._in_a_row = []
            return
        self._in_a_row.append(time)
        self.outliers.add(time)
        if len(self._in_a_row) > self._scaling.numbers.most_outliers:
            # Something else has moved the sphere there.
            self.outliers.difference_update(self._in_a_row)
            self._state = apply_error(self._state, np.concatenate((innovation, np.zeros(3))))
            self._covariance[:5, :] = self._covariance[:, :5] = 0.0
            self._covariance[:5, :5] = measured
            self._in_a_row = []

    def _measured(self) -> Vector:
        """Return the covariance of a pose measured at the time of the state, shape (5, 5)."""
        speeds = self._sent.at(self._time - self._lag)
        rate = pose_rate(self._state, speeds, self._constants, self.disturbance)
        return self._scaling.pose_covariance(self._pose_noise, self._pose_deviations, rate)

    def predict(self, time: float) -> tuple[Vector, Vector]:
        """Return the state at control time `time` [s] and the covariance of its pose, (5, 5)."""
        if not self._noisy:
            state = self._sent.predict(
                self._state, self._time - self._lag, time, self._constants, self._max_step,
                self.disturbance,
            )
            return state, self._covariance[:5, :5]
        state, covariance = self._moved(time)
        return state, covariance[:5, :5]

    def _moved(self, until: float) -> tuple[Vector, Vector]:
        """Return state and covariance once the speeds sent until then [s] have taken effect."""
        since, numbers = self._time - self._lag, self._scaling.numbers
        if until <= since:
            return self._state, self._covariance
        durations, speeds = self._sent.pieces(since, until)
        end = propagate(
            self._state, speeds, durations, self._constants, self._max_step, self.disturbance
        )
        by = np.eye(LOCAL)
        by[:ERROR_SIZE, :ERROR_SIZE] = end.by_start
        by[:ERROR_SIZE, KNOT:][:, CONSTANTS] = end.by_constants * self._scaling.nominal.as_array()
        by[:ERROR_SIZE, SLOPE_ERROR] = end.by_torques[:, :2]
        by[:ERROR_SIZE, KNOT:][:, IMBALANCE] = end.by_torques[:, 2:]
        turned = float(np.linalg.norm(error_between(self._state, end.state)[2:5]))
        # A random walk that comes as far within an interval as the moving horizon expects.
        share = (until - since) / numbers.spacing
        variances = np.zeros(LOCAL)
        variances[POSE_ERROR] = noise_variance(turned / share, numbers) * self._noise_scale * share
        if self.disturbance is not UNDISTURBED:
            variances[MOMENTUM_ERROR] = numbers.momentum_walk**2 * (until - since)
            variances[SLOPE_ERROR] = numbers.slope_walk**2 * (until - since)
        covariance = by @ self._covariance @ by.T + np.diag(variances)
        return end.state, covariance
