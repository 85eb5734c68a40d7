# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Contract between the controller and an estimator of the state and of the plant's parameters."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sphere_nmpc.estimation.plant_parameters import ParameterDistribution
from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import ControllerSettings


@dataclass(frozen=True, eq=False)
class PlantEstimate:
    """Parameters of the plant that predictions use; all of them of one update.

    Attributes
    ----------
    constants : LumpedConstants
        Estimated, or as built where learning is off.
    lag : float
        Delay of the motion behind the rotor speeds sent [s].
    noise : float
        Standard deviation of the disturbance of each state within a sample period [m, -].
    deviations : ndarray of shape (4,), or None
        Standard deviations of the estimated [Rs, c1, r1, r3]; None where the estimator does not
        report them.
    acceleration : float
        Rotor acceleration that the drives attain [rad/s^2]; inf where it is not less than asked.
    """

    constants: LumpedConstants
    lag: float
    noise: float
    deviations: Vector | None = None
    acceleration: float = float("inf")


@dataclass(frozen=True, eq=False)
class Estimate:
    """State and plant parameters at a sampling instant.

    Attributes
    ----------
    state : ndarray, shape (9,)
        Predicted state; its momentum is zero without evidence of any.
    plant : PlantEstimate
        Parameters of the plant.
    covariance : ndarray of shape (5, 5), or None
        Covariance of the error state: position [m; world frame], rotation vector [rad; body
        frame]. None where poses are trusted exactly.
    disturbance : Disturbance
        Slope and imbalance; zero without evidence of any.
    """

    state: Vector
    plant: PlantEstimate
    covariance: Vector | None = None
    disturbance: Disturbance = UNDISTURBED

    @property
    def uncertainty(self) -> float:
        """Standard deviation of the error of the state in R^6 [mixed units]; 0 if trusted."""
        if self.covariance is None:
            return 0.0
        variances = np.diag(self.covariance)
        # A rotation by a small angle moves its quaternion half as far.
        return float(np.sqrt(np.sum(variances[:2]) + 0.25 * np.sum(variances[2:])))


class Estimator(Protocol):
    """Estimator of state and plant parameters from poses and the rotor speeds sent."""

    @property
    def newest(self) -> tuple[float, Vector] | None:
        """Control time [s] of the newest pose, and the pose, shape (6,); None without any."""
        ...

    @property
    def plant(self) -> PlantEstimate:
        """The plant parameters estimated so far, also without a pose."""
        ...

    @property
    def parameters(self) -> ParameterDistribution:
        """Distribution of the estimated parameters, from which another estimator can start."""
        ...

    @property
    def momentum(self) -> Vector:
        """Momentum at the newest pose taken into account, shape (3,); kept without poses."""
        ...

    @property
    def disturbance(self) -> Disturbance:
        """Slope and imbalance as estimated so far."""
        ...

    def observe(self, time: float, pose: Vector) -> bool:
        """Take a pose, shape (6,), measured at control time `time` [s]; False if outdated."""
        ...

    def estimate(self, time: float) -> Estimate | None:
        """Return the estimate at control time `time` [s]; None without a pose.

        Where it raises the control loop falls back to the plan in force.
        """
        ...

    def change(self, settings: ControllerSettings) -> None:
        """Take over changed settings; estimates that they do not concern are kept.

        A changed ``drive_lag`` restarts the estimate of the lag from this prior mean.
        """
        ...

    def forget(self) -> None:
        """Discard all poses, as after a jump of the clock.

        Estimated parameters and disturbance stay; the momentum may have changed meanwhile.
        """
        ...
