# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""States of the strategy `time_optimal`; `strategy.py` has the transitions between them."""

from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import QUATERNION, STATE_SIZE, Vector
from sphere_nmpc.strategy.time_optimal.arrival import Arrival
from sphere_nmpc.strategy.time_optimal.planner import ArrivalPlanner


@dataclass(frozen=True, eq=False)
class Searching:
    """State without a plan: the rotors are ramped to rest, and a plan is searched for.

    Attributes
    ----------
    strict : bool
        Whether the last search ended with an arrival that does not reach the goal when it is
        solved precisely; the next one is then strict, as it would find the same again.
    fruitless : int
        Searches in succession that have ended without an arrival.
    """

    strict: bool = False
    fruitless: int = 0

    @property
    def found_none(self) -> bool:
        """Whether the last search ended without an arrival."""
        return self.fruitless > 0


@dataclass(frozen=True, eq=False)
class Following:
    """State in which a plan to the goal is followed.

    Attributes
    ----------
    arrival : Arrival
        The plan; its time 0 is `planned_at`.
    planned_at : float
        Control time of the sample at which it was solved [s].
    planner : ArrivalPlanner
        Planner with the drive limits of the plan.
    fruitless : int
        Number of searches for an earlier arrival since the last one that found it.
    work : int
        Planning effort to be spent on an earlier arrival at this sample.
    """

    arrival: Arrival
    planned_at: float
    planner: ArrivalPlanner
    fruitless: int = 0
    work: int = 0

    @property
    def arrives(self) -> float:
        """Control time of the arrival [s]."""
        return self.planned_at + self.arrival.duration

    @property
    def reaches(self) -> bool:
        """Whether the plan reaches the goal but for an error up to which plans are kept."""
        return self.arrival.error <= self.planner.tuning.kept_error(self.arrival.turns)

    def time_left(self, now: float) -> float:
        """Return the time from `now` to the arrival [s]."""
        return self.arrival.duration - (now - self.planned_at)

    def prediction(self, now: float) -> tuple[Vector, Drift]:
        """Return the state, shape (6,), and the drift that the plan has predicted for `now`."""
        arrival, elapsed = self.arrival, now - self.planned_at
        rows = np.hstack((arrival.states, arrival.momenta)).T
        found = np.array([np.interp(elapsed, arrival.hold.times, row) for row in rows])
        state, momentum = found[:STATE_SIZE], found[STATE_SIZE:]
        state[QUATERNION] /= np.linalg.norm(state[QUATERNION])
        return state, replace(arrival.drift, momentum=momentum)

    def rest(self, now: float) -> FirstOrderHold:
        """Return what remains of the plan at `now` [s], from time 0 (now) on."""
        elapsed, hold = now - self.planned_at, self.arrival.hold
        return hold.starting_at(elapsed, hold.at(elapsed)).delayed(-elapsed)


@dataclass(frozen=True)
class Holding:
    """State in which the sphere rests at the goal.

    Attributes
    ----------
    leaving_error : float
        Error [norm in R^6] below which it stays there, whatever the dead band.
    """

    leaving_error: float


@dataclass(frozen=True)
class Saturated:
    """State in which the rotors cannot hold the momentum and stay at their limits."""


State = Searching | Following | Holding | Saturated
