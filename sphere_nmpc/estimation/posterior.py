# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the poses up to a knot tell of the state, the disturbances and the plant."""

from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.estimation.events import TIGHT
from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.estimation.unknowns import (
    DISTURBANCE,
    EXACT,
    IMBALANCE,
    KNOT,
    LAG,
    MOMENTUM_ERROR,
    POSE_ERROR,
    SLOPE_ERROR,
    PoseNoise,
    Scaling,
    disturbance_of,
)
from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.state import MOMENTUM, POSE, POSE_SIZE, Vector

_NEVER = 1_000_000
"""Number of intervals since what has not happened."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Distribution of the newest knot and the common unknowns, and what it depends on.

    Attributes
    ----------
    time : float
        Control time of the knot [s].
    knot, common : ndarray, shapes (11,) and (9,)
        Mean.
    covariance : ndarray, shape (19, 19)
        That of the local unknowns. Those that are fixed have their prior variance.
    undisturbed : bool
        Whether momentum, slope and imbalance are zero.
    unbalanced, weak : bool
        Whether there is an imbalance, and whether drives attain less than the limit.
    noise : float
        Standard deviation of the errors of predicted poses, of each state [m, -].
    scale : float
        Scale of the noise's variance [-].
    slipped : int
        Intervals since the sphere has slipped.
    pose_noise : PoseNoise
        Noise of the poses beyond that given.
    """

    time: float
    knot: Vector
    common: Vector
    covariance: Vector
    undisturbed: bool = True
    unbalanced: bool = False
    weak: bool = False
    noise: float = 0.0
    scale: float = 1.0
    slipped: int = _NEVER
    pose_noise: PoseNoise = EXACT

    @classmethod
    def initial(cls, lag: float, scaling: Scaling) -> "Posterior":
        """Return what is known before the first pose, with an expected lag [s]."""
        knot = np.zeros(POSE_SIZE + 5)
        knot[2] = 1.0
        deviations = np.concatenate((np.ones(5), np.full(5, TIGHT), scaling.deviations))
        return cls(-np.inf, knot, scaling.prior(lag), np.diag(deviations**2))

    @property
    def is_valid(self) -> bool:
        """Whether a fit can begin from it: a finite mean, a positive definite covariance."""
        given = (self.knot, self.common, self.covariance)
        if not all(np.isfinite(one).all() for one in given):
            return False
        try:
            np.linalg.cholesky(np.linalg.inv(self.covariance))
        except np.linalg.LinAlgError:
            return False
        return bool((np.diag(self.covariance) > 0.0).all())

    @property
    def disturbance(self) -> Vector:
        """Momentum, slope and imbalance, shape (8,), at the places `DISTURBANCE`."""
        return np.concatenate((self.knot[MOMENTUM.start :], self.common[IMBALANCE]))

    @property
    def slope_and_imbalance(self) -> Disturbance:
        """Slope and imbalance; `UNDISTURBED` where they are zero."""
        return UNDISTURBED if self.undisturbed else disturbance_of(self.knot, self.common)

    def with_lag(self, lag: float, scaling: Scaling) -> "Posterior":
        """Return it with the prior of another lag [s] in place of its estimate."""
        common, covariance = self.common.copy(), self.covariance.copy()
        common[LAG] = scaling.prior(lag)[LAG]
        at = KNOT + LAG
        covariance[at, :] = covariance[:, at] = 0.0
        covariance[at, at] = scaling.deviations[LAG] ** 2
        return replace(self, common=common, covariance=covariance)

    def without_disturbance(self, numbers: EstimatorSettings) -> "Posterior":
        """Return it with zero momentum, slope and imbalance."""
        knot, common, covariance = self.knot.copy(), self.common.copy(), self.covariance.copy()
        knot[MOMENTUM.start :] = 0.0
        common[IMBALANCE] = 0.0
        covariance[DISTURBANCE, :] = covariance[:, DISTURBANCE] = 0.0
        variances = np.repeat([TIGHT**2, numbers.imbalance**2], [5, 3])
        covariance[DISTURBANCE, DISTURBANCE] = variances
        return replace(
            self, knot=knot, common=common, covariance=covariance, undisturbed=True,
            unbalanced=False,
        )

    def with_unknown_momentum(self, numbers: EstimatorSettings) -> "Posterior":
        """Return it with more variance of momentum and slope, whatever they are."""
        covariance = self.covariance.copy()
        covariance[MOMENTUM_ERROR, MOMENTUM_ERROR] += np.eye(3) * numbers.push**2
        covariance[SLOPE_ERROR, SLOPE_ERROR] += np.eye(2) * numbers.tilt**2
        return replace(self, covariance=covariance, undisturbed=False)

    def at_pose(self, time: float, pose: Vector, variance: Vector) -> "Posterior":
        """Return it at a pose, shape (6,), measured with a variance, shape (5,), after a gap.

        What happened to the momentum in between is not known, if there is any.
        """
        knot, covariance = self.knot.copy(), self.covariance.copy()
        knot[POSE] = pose
        covariance[POSE_ERROR, :] = covariance[:, POSE_ERROR] = 0.0
        covariance[POSE_ERROR, POSE_ERROR] = np.diag(variance)
        return replace(self, time=time, knot=knot, covariance=covariance)

    def is_zero(self, numbers: EstimatorSettings) -> bool:
        """Return whether momentum, slope and imbalance may well be zero.

        They are within a few standard deviations of it, and known so well that zero is more
        probable than other values (the Savage-Dickey ratio).
        """
        places = DISTURBANCE if self.unbalanced else DISTURBANCE[:5]
        values, within = self.disturbance[: places.size], self.covariance[np.ix_(places, places)]
        square = float(values @ np.linalg.solve(within, values))
        wide = np.repeat([numbers.push, numbers.tilt, numbers.imbalance], [3, 2, 3])[: places.size]
        narrowed = float(np.linalg.slogdet(within)[1]) - 2.0 * float(np.sum(np.log(wide)))
        return square < numbers.improbable and square + narrowed < -numbers.improbable
