# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tasks of learning that a worker does; it keeps the estimator from one task to the next."""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.estimation.drifting_plant import DriftingPlant, DriftingPlantEstimator
from sphere_nmpc.estimation.transition import Transition
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector
from sphere_nmpc.worker.contract import Store

_KEY = "learning"


@dataclass(frozen=True, eq=False)
class Begin:
    """Task that makes a new estimator; attributes as for `DriftingPlantEstimator`."""

    nominal: LumpedConstants
    mean: Vector
    momentum: bool
    acceleration: float = np.inf

    def estimator(self) -> DriftingPlantEstimator:
        """Return a new estimator."""
        return DriftingPlantEstimator(self.nominal, self.mean, self.momentum, self.acceleration)

    def __call__(self, store: Store) -> DriftingPlant:
        """Make the estimator in the worker."""
        made = store[_KEY] = self.estimator()
        return made.result


@dataclass(frozen=True, eq=False)
class Observe:
    """Task that takes a transition into account; attributes as for its `observe`."""

    transition: Transition
    time: float
    connected: bool

    def __call__(self, store: Store) -> DriftingPlant | None:
        """Update the estimator in the worker; None where the worker has lost it."""
        estimator: DriftingPlantEstimator | None = store.get(_KEY)
        if estimator is None:
            return None
        estimator.observe(self.transition, self.time, self.connected)
        return estimator.result


@dataclass(frozen=True)
class Restart:
    """Task that keeps the constants and takes another lag [s] as prior."""

    lag: float

    def __call__(self, store: Store) -> DriftingPlant | None:
        """Replace the estimator in the worker; None where the worker has lost it."""
        estimator: DriftingPlantEstimator | None = store.get(_KEY)
        if estimator is None:
            return None
        estimator = store[_KEY] = estimator.restarted(self.lag)
        return estimator.result
