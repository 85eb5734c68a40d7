# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Learning of the plant's parameters, in line or by a worker beside the control loop.

A worker does the tasks `Begin`, `Observe` and `Restart` and keeps the estimator between them.
"""

from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.estimation.drifting_plant import DriftingPlant, DriftingPlantEstimator
from sphere_nmpc.estimation.transition import Transition
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector
from sphere_nmpc.worker.contract import Reply, Store, Task, Worker

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


class InLineLearning:
    """Learning of which each result is complete when `observe` returns."""

    def __init__(self, begin: Begin) -> None:
        self._estimator = begin.estimator()

    @property
    def result(self) -> DriftingPlant:
        """The present estimate."""
        return self._estimator.result

    def observe(self, transition: Transition, time: float, connected: bool) -> bool:
        """Take a transition that ends at control time `time` [s] into account."""
        self._estimator.observe(transition, time, connected)
        return True

    def restart(self, lag: float) -> None:
        """Keep the constants, and take another lag [s] as prior."""
        self._estimator = self._estimator.restarted(lag)


class LearningBeside:
    """The same by a worker: the result is that of the newest task that is complete.

    Where the worker has lost the estimator, as it has ended, another one begins with the
    parameters known so far.
    """

    def __init__(self, begin: Begin, worker: Worker) -> None:
        self._begin = begin
        self._worker = worker
        self._result = begin.estimator().result
        self._replies: list[Reply[DriftingPlant | None]] = []
        self._begun = self._submit(begin)

    @property
    def result(self) -> DriftingPlant:
        """The newest estimate."""
        self._collect()
        return self._result

    def observe(self, transition: Transition, time: float, connected: bool) -> bool:
        """Submit a transition; False where the worker does not take it."""
        self._collect()
        if not self._begun:
            self._begun = self._submit(self._begin)
            connected = False
        return self._begun and self._submit(Observe(transition, time, connected))

    def restart(self, lag: float) -> None:
        """Keep the constants, and take another lag [s] as prior."""
        self._collect()
        begin = replace(self._begin, mean=self._result.parameters.with_lag_prior(lag).mean)
        # What is known until the worker has answered; it keeps noise and drift as well.
        self._result = begin.estimator().result
        self._begin, self._replies = begin, []
        if self._begun:
            self._begun = self._submit(Restart(lag))

    def _submit(self, task: Task[DriftingPlant | None]) -> bool:
        reply = self._worker.submit(task)
        self._replies.append(reply)
        return not reply.error

    def _collect(self) -> None:
        """Take over the results that have arrived."""
        self._worker.poll()
        replies = self._replies
        while replies and not replies[0].pending:
            reply = replies.pop(0)
            if reply.result is not None:
                self._result = reply.result
            elif reply.ready and self._begun:
                self._begin = replace(self._begin, mean=self._result.parameters.mean)
                self._begun = False
