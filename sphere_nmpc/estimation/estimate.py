# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimate of the state and of the plant at a sampling instant."""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector


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
    deviations : ndarray, shape (4,)
        Standard deviations of the estimated [Rs, c1, r1, r3].
    acceleration : float
        Rotor acceleration that the drives attain [rad/s^2]; inf where it is not less than asked.
    slippery : bool
        Whether the sphere has slipped recently.
    """

    constants: LumpedConstants
    lag: float
    noise: float
    deviations: Vector
    acceleration: float = float("inf")
    slippery: bool = False


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
    def place_deviation(self) -> float:
        """Standard deviation of the error of the position, whatever its direction [m]."""
        if self.covariance is None:
            return 0.0
        return float(np.sqrt(max(self.covariance[0, 0], self.covariance[1, 1])))

    @property
    def uncertainty(self) -> float:
        """Standard deviation of the error of the state in R^6 [mixed units]; 0 if trusted."""
        if self.covariance is None:
            return 0.0
        variances = np.diag(self.covariance)
        # A rotation by a small angle moves its quaternion half as far.
        return float(np.sqrt(np.sum(variances[:2]) + 0.25 * np.sum(variances[2:])))
