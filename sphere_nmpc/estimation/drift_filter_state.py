# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""State of the extended Kalman filter with momentum, slope and imbalance."""

from dataclasses import dataclass, field, replace

import numpy as np

from sphere_nmpc.estimation.filter_state import (
    SIZE,
    Constants,
    FilterState,
    PoseNoise,
    State,
)
from sphere_nmpc.estimation.plant_parameters import (
    PRIOR_DEVIATION,
    ParameterDistribution,
    ParameterScaling,
)
from sphere_nmpc.model.drift import DRIFT_SIZE, IMBALANCE, SLOPE, Drift
from sphere_nmpc.model.drift_propagation import propagate_with_drift, state_rates_with_drift
from sphere_nmpc.model.state import QUATERNION, Vector

PRIOR = np.array([30.0, 30.0, 1.0, 7.0, 7.0, 3.0, 3.0, 3.0])
"""Prior standard deviations of momentum [rad/s], slope and imbalance [rad/s^2]."""
WALK = np.array([0.1, 0.1, 0.1, 0.3, 0.3, 0.02, 0.02, 0.02])
"""Random walk of these [their units per root of a second]."""
PUSHED = np.array([30.0, 30.0, 1.0, 0.3, 0.3, 0.3, 0.3, 0.3])
"""Standard deviations of these after a push of a sphere that had no drift."""
PUSH = np.array([30.0, 30.0, 1.0, 0.3, 0.3, 0.0, 0.0, 0.0])
"""Standard deviations of their jumps at a push."""

_Drift = slice(SIZE, SIZE + DRIFT_SIZE)
_Momentum = slice(SIZE, SIZE + 3)
_Torques = slice(SIZE + 3, SIZE + DRIFT_SIZE)
_Moving = np.r_[State, _Momentum]
_Learnt = np.r_[Constants, _Torques]


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
