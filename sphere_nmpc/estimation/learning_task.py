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
        store[_KEY] = self.estimator()
        return _result(store)


@dataclass(frozen=True, eq=False)
class Observe:
    """Task that takes a transition into account; attributes as for its `observe`."""

    transition: Transition
    time: float
    connected: bool

    def __call__(self, store: Store) -> DriftingPlant:
        """Update the estimator in the worker."""
        _estimator(store).observe(self.transition, self.time, self.connected)
        return _result(store)


@dataclass(frozen=True)
class Restart:
    """Task that keeps the constants and takes another lag [s] as prior."""

    lag: float

    def __call__(self, store: Store) -> DriftingPlant:
        """Replace the estimator in the worker."""
        store[_KEY] = _estimator(store).restarted(self.lag)
        return _result(store)


def _estimator(store: Store) -> DriftingPlantEstimator:
    estimator: DriftingPlantEstimator = store[_KEY]
    return estimator


def _result(store: Store) -> DriftingPlant:
    return _estimator(store).result
