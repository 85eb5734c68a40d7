# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""State of the extended Kalman filter: prediction with the inputs sent and update with a pose.

There are two kinds: with the paper's model, and with momentum, slope and imbalance.
"""

from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from sphere_nmpc.estimation import plant_parameters
from sphere_nmpc.estimation.drift import (
    DRIFT_SIZE,
    ERROR_SIZE,
    IMBALANCE,
    NO_DRIFT,
    SLOPE,
    Drift,
    propagate,
    propagate_with_drift,
    state_rates,
    state_rates_with_drift,
)
from sphere_nmpc.estimation.plant_parameters import (
    LAG_PRIOR,
    PRIOR_DEVIATION,
    ParameterDistribution,
    ParameterScaling,
)
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.state import QUATERNION, Vector

SIZE = ERROR_SIZE + plant_parameters.SIZE
"""Size of the joint error state: error of the state, then of the scaled parameters."""
GATE = 27.0
"""Normalised innovation squared above which a pose is an outlier: exceeded by 1 valid pose in
16000 (chi-squared, 5 degrees of freedom)."""
REST_NOISE = 5e-5
"""Process noise of a robot at rest [m or rad per root of a second]."""
ROLLING_NOISE = 1e-3
"""Process noise of a rolling robot over its speed [root of a second]: 0.1 % of the distance
rolled in one second."""
CONSTANTS_NOISE = 1e-4
"""Process noise of the scaled constants while the rotors turn [1 / sqrt(s)]."""
CONSISTENT, INCONSISTENT = 1.2, 1.6
"""Average innovation ratio below which the process-noise inflation is reduced, above which it is
increased ..."""
DECREASE, INCREASE = 0.9, 1.5
"""... by these factors a pose ..."""
MAX_INFLATION = 1e4
"""... up to this one."""
_AVERAGED = 12.0
"""Number of poses in the average of the innovation ratio."""
_MAX_RATIO = 4.0
"""Largest ratio in that average, so that a single outlier within the gate inflates nothing."""
_TURNING = 1.0
"""Rotor speed [rad/s] below which the constants have no process noise."""
PRIOR = np.array([30.0, 30.0, 1.0, 7.0, 7.0, 3.0, 3.0, 3.0])
"""Prior standard deviations of momentum [rad/s], slope and imbalance [rad/s^2]."""
WALK = np.array([0.1, 0.1, 0.1, 0.3, 0.3, 0.02, 0.02, 0.02])
"""Random walk of these [their units per root of a second]."""
PUSHED = np.array([30.0, 30.0, 1.0, 0.3, 0.3, 0.3, 0.3, 0.3])
"""Standard deviations of these after a push of a sphere that had no drift."""
PUSH = np.array([30.0, 30.0, 1.0, 0.3, 0.3, 0.0, 0.0, 0.0])
"""Standard deviations of their jumps at a push."""

State = slice(0, ERROR_SIZE)
Parameters = slice(ERROR_SIZE, SIZE)
Constants = slice(ERROR_SIZE, SIZE - 1)
_LAG = SIZE - 1
_Drift = slice(SIZE, SIZE + DRIFT_SIZE)
_Momentum = slice(SIZE, SIZE + 3)
_Torques = slice(SIZE + 3, SIZE + DRIFT_SIZE)
_Moving = np.r_[State, _Momentum]
_Learnt = np.r_[Constants, _Torques]

Kind = TypeVar("Kind", bound="FilterState")
"""Model of the filter."""


@dataclass(frozen=True)
class PoseNoise:
    """Standard deviations of a measured pose about each axis: position [m], angle [rad]."""

    position: float
    angle: float

    @property
    def covariance(self) -> Vector:
        """Covariance of the error of a pose, shape (5, 5)."""
        matrix: Vector = np.diag([self.position**2] * 2 + [self.angle**2] * 3)
        return matrix


@dataclass(frozen=True, eq=False)
class FilterState:
    """Gaussian on the plane, SO(3) and the scaled parameters; immutable.

    Attributes
    ----------
    time : float
        Control time up to which inputs are taken into account [s]: that of the pose less the lag.
    state : ndarray, shape (6,)
    scaled : ndarray, shape (5,)
        Mean of the scaled parameters.
    joint : ndarray, shape (10, 10)
        Covariance of the error of the state and of the scaled parameters.
    scaling : ParameterScaling
        Units and range of the parameters.
    inflation : float
        Factor on the variance of the process noise, 1 while innovations are as expected.
    ratio : float
        Average of the normalised innovation squared over its expectation.
    likelihood : float
        Logarithm of the likelihood of the last pose, up to a constant.
    outliers : tuple of (float, ndarray)
        Stamps and poses rejected since the last one that was fused.
    """

    time: float
    state: Vector
    scaled: Vector
    joint: Vector
    scaling: ParameterScaling
    inflation: float = 1.0
    ratio: float = 1.0
    likelihood: float = 0.0
    outliers: tuple[tuple[float, Vector], ...] = ()

    @classmethod
    def at_pose(
        cls: type[Kind],
        stamp: float,
        pose: Vector,
        noise: PoseNoise,
        scaling: ParameterScaling,
        parameters: ParameterDistribution,
    ) -> Kind:
        """Return the state after one pose, shape (6,), with the parameters known before."""
        joint = np.zeros((SIZE, SIZE))
        joint[State, State] = noise.covariance
        joint[Parameters, Parameters] = parameters.covariance
        mean = parameters.mean
        return cls(stamp - scaling.lag(mean), pose, mean, joint, scaling)

    @property
    def covariance(self) -> Vector:
        """Covariance of the error state [m; world frame, rad; body frame], shape (5, 5)."""
        return self.joint[State, State].copy()

    @property
    def drift(self) -> Drift:
        """Drift of the model."""
        return NO_DRIFT

    @property
    def parameters(self) -> ParameterDistribution:
        """Distribution of the scaled parameters."""
        return ParameterDistribution(self.scaled, self.joint[Parameters, Parameters].copy())

    @property
    def constants(self) -> Vector:
        """[Rs, c1, r1, r3], shape (4,)."""
        return self.scaling.constants(self.scaled)

    def with_parameters(
        self: Kind, parameters: ParameterDistribution, stamp: float, sent: SentInputs
    ) -> Kind:
        """Return the estimate of the robot's state at `stamp` [s] with other parameters.

        An error of the new lag is an error of the time to which the inputs have moved the robot,
        and so an error of the state in the direction of motion.
        """
        time = stamp - self.scaling.lag(parameters.mean)
        constants = self.scaling.constants(parameters.mean)
        joint: Vector = self.joint.copy()
        joint[:, Parameters] = joint[Parameters, :] = 0.0
        joint[Parameters, Parameters] = parameters.covariance
        by_lag = np.eye(joint.shape[0])
        by_lag[State, _LAG] = LAG_PRIOR * self._rates(sent.at(time), constants)
        joint = by_lag @ joint @ by_lag.T
        return replace(self, time=time, scaled=parameters.mean, joint=joint)

    def predicted(self: Kind, time: float, sent: SentInputs) -> Kind:
        """Return the state predicted to a later time [s] with the inputs sent."""
        if time <= self.time:
            return self
        durations, speeds = sent.pieces(self.time, time)
        current = self
        for duration, here, there in zip(durations, speeds[:-1], speeds[1:], strict=True):
            current = current._advanced(here, there, float(duration))
        return replace(current, time=time)

    def updated(
        self: Kind, stamp: float, pose: Vector, noise: PoseNoise, sent: SentInputs
    ) -> tuple[Kind, bool]:
        """Fuse a pose, shape (6,), measured at `stamp` [s].

        Returns
        -------
        state : FilterState
            With the pose, or the prediction alone if the pose is an outlier.
        fused : bool
            Whether the pose passed the gate.
        """
        prior = self.predicted(stamp - self.scaling.lag(self.scaled), sent)
        return prior._fused(pose, noise, sent.at(prior.time))

    def _fused(
        self: Kind, pose: Vector, noise: PoseNoise, speeds: Vector
    ) -> tuple[Kind, bool]:
        """Fuse a pose of this instant, at which `speeds` [rad/s] were in force; see `updated`."""
        size = self.joint.shape[0]
        # If the lag is longer than estimated, the pose is of an earlier state.
        output = np.zeros((ERROR_SIZE, size))
        output[:, State] = np.eye(ERROR_SIZE)
        output[:, _LAG] = -LAG_PRIOR * self._rates(speeds, self.constants)
        pose_covariance = noise.covariance
        innovation_covariance = output @ self.joint @ output.T + pose_covariance
        innovation = error_between(self.state, pose)
        normalised = float(innovation @ np.linalg.solve(innovation_covariance, innovation))
        spread = float(np.linalg.slogdet(innovation_covariance)[1])
        likelihood = -0.5 * (min(normalised, 2.0 * GATE) + spread)
        if normalised > GATE:
            return replace(self, likelihood=likelihood), False
        gain = np.linalg.solve(innovation_covariance, output @ self.joint).T
        kept = np.eye(size) - gain @ output
        joint = kept @ self.joint @ kept.T + gain @ pose_covariance @ gain.T
        ratio = min(normalised / ERROR_SIZE, _MAX_RATIO)
        average = self.ratio + (ratio - self.ratio) / _AVERAGED
        posterior = replace(
            self._corrected(gain @ innovation),
            joint=0.5 * (joint + joint.T),
            inflation=_inflation(self.inflation, average),
            ratio=average,
            likelihood=likelihood,
            outliers=(),
        )
        return posterior, True

    def _rates(self, speeds: Vector, constants: Vector) -> Vector:
        """Return the rates of the state, shape (5,), at rotor speeds (2,) [rad/s]."""
        return state_rates(self.state, speeds, constants)

    def _advanced(self: Kind, here: Vector, there: Vector, duration: float) -> Kind:
        """Return the state after a straight piece of the rotor speeds."""
        state, by_state, by_constants = propagate(
            self.state, (here, there), duration, self.constants
        )
        transition = np.eye(SIZE)
        transition[State, State] = by_state
        transition[State, Constants] = by_constants * self.scaling.slopes()
        joint = transition @ self.joint @ transition.T
        joint += self._process_noise(duration, 0.5 * (here + there))
        return replace(self, state=state, joint=joint)

    def _corrected(self: Kind, correction: Vector) -> Kind:
        """Return the state with a correction of its means."""
        return replace(
            self,
            state=apply_error(self.state, correction[State]),
            scaled=self.scaling.within(self.scaled + correction[Parameters]),
        )

    def _process_noise(self, duration: float, speeds: Vector) -> Vector:
        """Return the process noise, (10, 10), of an interval at constant speeds [rad/s]."""
        turning = float(np.max(np.abs(speeds)))
        rate = float(self.constants[1] * np.linalg.norm(speeds))
        variances = np.zeros(SIZE)
        shift = REST_NOISE**2 + (ROLLING_NOISE * rate * self.constants[0]) ** 2
        turn = REST_NOISE**2 + (ROLLING_NOISE * rate) ** 2
        variances[:2], variances[2:ERROR_SIZE] = shift, turn
        variances *= self.inflation
        learning = self.joint[_LAG, _LAG] > 0.0
        if turning > _TURNING and learning:
            variances[Constants] = CONSTANTS_NOISE**2
        noise: Vector = np.diag(variances * duration)
        return noise


def _inflation(inflation: float, ratio: float) -> float:
    """Return the process-noise inflation after a pose, given the average innovation ratio."""
    if ratio > INCONSISTENT:
        return min(MAX_INFLATION, INCREASE * inflation)
    if ratio < CONSISTENT:
        return max(1.0, DECREASE * inflation)
    return inflation


@dataclass(frozen=True, eq=False)
class DriftFilterState(FilterState):
    """`FilterState` with drift: its joint covariance is (18, 18), the drift comes last.

    Attributes
    ----------
    values : ndarray, shape (8,)
        The drift as an array.
    """

    values: Vector = field(default_factory=lambda: np.zeros(DRIFT_SIZE))

    @classmethod
    def at_pose(
        cls,
        stamp: float,
        pose: Vector,
        noise: PoseNoise,
        scaling: ParameterScaling,
        parameters: ParameterDistribution,
    ) -> "DriftFilterState":
        """Return the state after one pose, shape (6,), with the parameters known before."""
        paper = FilterState.at_pose(stamp, pose, noise, scaling, parameters)
        return cls.from_paper(paper, PRIOR)

    @classmethod
    def from_paper(cls, paper: FilterState, deviations: Vector) -> "DriftFilterState":
        """Return a state of the paper's model with zero drift of these deviations, shape (8,)."""
        joint = np.zeros((SIZE + DRIFT_SIZE, SIZE + DRIFT_SIZE))
        joint[:SIZE, :SIZE] = paper.joint
        joint[_Drift, _Drift] = np.diag(deviations**2)
        return cls(paper.time, paper.state, paper.scaled, joint, paper.scaling, paper.inflation)

    @property
    def drift(self) -> Drift:
        """Drift at the time of the state."""
        return Drift.from_array(self.values)

    def pushed(self) -> "DriftFilterState":
        """Return the state with the variance of a push."""
        joint = self.joint.copy()
        joint[_Drift, _Drift] += np.diag(PUSH**2)
        return replace(self, joint=joint)

    def with_drift_of(self, known: "DriftFilterState") -> "DriftFilterState":
        """Return the state with a drift that was known before, with the variance of a push."""
        joint = self.joint.copy()
        joint[_Drift, _Drift] = known.joint[_Drift, _Drift] + np.diag(PUSH**2)
        return replace(self, joint=joint, values=known.values)

    def doubted(self) -> "DriftFilterState":
        """Return the state with little faith in what was learnt: torques and parameters.

        Both were fitted to a motion with another cause. The lag is kept, and parameters that are
        taken as exact.
        """
        joint, values = self.joint.copy(), self.values.copy()
        joint[_Learnt, :] = joint[:, _Learnt] = 0.0
        joint[_Drift, _Drift] += np.diag(PRIOR**2)
        if self.joint[Constants, Constants].any():
            joint[Constants, Constants] = np.diag(PRIOR_DEVIATION[:-1] ** 2)
        values[SLOPE] = values[IMBALANCE] = 0.0
        return replace(self, joint=joint, values=values)

    def _rates(self, speeds: Vector, constants: Vector) -> Vector:
        return state_rates_with_drift(self.state, self.drift, speeds, constants)

    def _advanced(self, here: Vector, there: Vector, duration: float) -> "DriftFilterState":
        end = propagate_with_drift(
            self.state, self.drift, np.array([duration]), np.array([here, there]), self.constants
        )
        transition = np.eye(SIZE + DRIFT_SIZE)
        transition[np.ix_(_Moving, _Moving)] = end.by_start
        transition[_Moving, Constants] = end.by_constants * self.scaling.slopes()
        transition[_Moving, _Torques] = end.by_torques
        joint = transition @ self.joint @ transition.T
        # The sphere is at rest where the rotors hold the momentum.
        moving = 0.5 * (here + there) - self.drift.rest_speeds(end.state[QUATERNION])
        joint[:SIZE, :SIZE] += self._process_noise(duration, moving)
        joint[_Drift, _Drift] += np.diag(WALK**2 * duration)
        values = np.concatenate((end.momentum, self.values[SLOPE], self.values[IMBALANCE]))
        return replace(self, state=end.state, joint=joint, values=values)

    def _corrected(self, correction: Vector) -> "DriftFilterState":
        corrected = super()._corrected(correction)
        return replace(corrected, values=self.values + correction[_Drift])
