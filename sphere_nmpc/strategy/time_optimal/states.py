# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""States of the strategy `time_optimal`, and the plan that is followed, solved again.

`strategy.py` has the transitions between the states.
"""

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import (
    MOMENTUM,
    QUATERNION,
    Vector,
    angle_error,
    nearer_sign,
    position_error,
)
from sphere_nmpc.strategy.clearance import Margin, clearance_of
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.rest import hold_momentum
from sphere_nmpc.strategy.time_optimal.arrival import RAISES, Arrival, ArrivalSolver
from sphere_nmpc.strategy.time_optimal.guide import way_of_time
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

_LEAST_GAIN = 5e-3
"""Time [1 / (c1 u_max)] by which a plan has to arrive earlier to replace the one in force."""
_ENDED = 1e-3
"""Time left of a plan [s] below which it has ended."""


def is_near(
    goal: Vector, other: Vector, constants: LumpedConstants, settings: TimeOptimalSettings
) -> bool:
    """Return whether a plan to one goal, shape (6,), is changed to another one, not dropped."""
    if np.array_equal(goal, other):  # as at nearly every sample, in a fifth of the time
        return True
    allowed = settings.largest_change_of_goal
    near = position_error(goal, other) < allowed * constants.shell_radius
    return near and angle_error(goal, other) < allowed


@dataclass(frozen=True)
class Searching:
    """State without a plan: the rotors are ramped to rest, and a plan is searched for.

    Attributes
    ----------
    fruitless : int
        Searches in succession that have ended without an arrival.
    """

    fruitless: int = 0


@dataclass(frozen=True, eq=False)
class Following:
    """State in which a plan is followed.

    Attributes
    ----------
    arrival : Arrival
        The plan; its time 0 is `planned_at`.
    planned_at : float
        Control time of the sample at which it was solved [s].
    solver : ArrivalSolver
        Solver with the drive limits of the plan.
    reaches : bool
        Whether it ends within the dead band.
    fruitless : int
        Number of searches for an earlier arrival since the last one that found it.
    motion : int
        Number of the search that has found it.
    final : ndarray of shape (6,), or None
        Final goal, where that of the plan is on the way to it.
    rested : ndarray of shape (2,), or None
        Where the sphere has rested before the plan and those that it has taken the place of [m].
    """

    arrival: Arrival
    planned_at: float
    solver: ArrivalSolver
    reaches: bool = True
    fruitless: int = 0
    motion: int = 0
    final: Vector | None = None
    rested: Vector | None = None

    @property
    def arrives(self) -> float:
        """Control time of the arrival at the final goal [s], to be expected from now on."""
        return self.planned_at + self.arrival.duration + self.arrival.to_go

    @property
    def is_part(self) -> bool:
        """Whether the goal of the plan is on the way to the final one."""
        return self.arrival.to_go > 0.0

    def leads_to(self, situation: Situation) -> bool:
        """Return whether the goal of a situation is that of the plan, or has changed by little.

        The change is that of where the goal will be when the plan arrives: the goal moves, or
        momentum changes the orientation that can be held.
        """
        own = self.arrival.goal_after(self.arrival.duration)
        if self.final is not None:
            own = situation.orientation.nearest(self.final, situation.goal)
        goal = situation.goal_after(self.time_left(situation.time))
        return is_near(own, goal, situation.constants, self.solver.settings)

    def aimed_at(self, situation: Situation) -> "Following":
        """Return the plan with the goal of a situation, which it is solved for from then on."""
        if self.is_part:
            return self
        goal = situation.goal_after(self.planned_at - situation.time)
        arrival = replace(
            self.arrival, goal=nearer_sign(goal, self.arrival.goal),
            goal_rate=situation.goal_rate,
        )
        return replace(self, arrival=arrival)

    def time_left(self, now: float) -> float:
        """Return the time from `now` to the arrival [s]."""
        return self.arrival.duration - (now - self.planned_at)

    def prediction(self, now: float) -> Vector:
        """Return the state, shape (9,), that the plan has predicted for `now`."""
        times, states = self.arrival.hold.times, self.arrival.states
        elapsed = min(max(now - self.planned_at, 0.0), self.arrival.duration)
        i = max(1, int(np.searchsorted(times, elapsed)))
        share = (elapsed - times[i - 1]) / (times[i] - times[i - 1])
        state: Vector = states[i - 1] + share * (states[i] - states[i - 1])
        state[QUATERNION] /= np.linalg.norm(state[QUATERNION])
        return state

    def momentum_at_arrival(self, situation: Situation) -> Vector:
        """Return the momentum of now with what it gains until the arrival, shape (3,)."""
        if self.solver.settings.is_out_of_balance(situation):
            return self.arrival.momentum  # what differs now is planned away
        predicted = self.prediction(situation.time)[MOMENTUM]
        return situation.momentum + (self.arrival.momentum - predicted)

    def rest(self, now: float) -> FirstOrderHold:
        """Return what remains of the plan at `now` [s], from time 0 (now) on."""
        elapsed, hold = now - self.planned_at, self.arrival.hold
        grid = self.solver.grid
        rest = hold.starting_at(elapsed, hold.at(elapsed)).delayed(-elapsed)
        return grid.thinned(grid.split(rest))

    def solved_again(
        self, situation: Situation, dead_band: float, deadline: float
    ) -> "Following | None":
        """Return what remains of the plan, solved from the present state; None if it has ended.

        Parameters
        ----------
        situation : Situation
            The present one; what is aimed at is the goal of the plan.
        dead_band : float
            Error within which the sphere rests at the goal.
        deadline : float
            Steady clock reading at which to stop [s].
        """
        now, settings, arrival = situation.time, self.solver.settings, self.arrival
        if self.time_left(now) < _ENDED:
            return None
        hold = self.rest(now)
        goal = arrival.goal_after(now - self.planned_at)
        situation = replace(
            situation, goal_rate=arrival.goal_rate, orientation=arrival.orientation
        )
        # With noise an error is left where it would take a manoeuvre to correct it.
        noisy = settings.noisy_share * (dead_band - settings.least_dead_band)
        wanted = max(settings.arrival_error, noisy)
        for factor in RAISES:
            arrival = self.solver.solve(
                situation, goal, hold, factor, deadline - time.perf_counter(), kept=True
            )
            if arrival.error <= wanted or time.perf_counter() > deadline:
                break
            hold = arrival.hold
        clearance = clearance_of(situation, arrival.hold, Margin.KEPT)
        if math.isnan(clearance):
            # What remains of a plan that kept clear may still do so as it is.
            arrival = self.arrival.followed(situation, self.rest(now))
            clearance = clearance_of(situation, arrival.hold, Margin.KEPT)
            if math.isnan(clearance):
                return None
        arrival = replace(arrival, to_go=self.arrival.to_go, clearance=clearance)
        rests = max(dead_band, settings.leaving_error)
        return replace(self, arrival=arrival, planned_at=now, reaches=arrival.error <= rests)


    def as_plan(self, situation: Situation, max_speed: float) -> Plan:
        """Return the plan for a situation; the rotors turn at `max_speed` [rad/s] at most."""
        arrival, start = self.arrival, self.planned_at
        states = arrival.states
        hold = hold_momentum(
            arrival.hold.delayed(start), arrival.momentum, arrival.disturbance,
            arrival.goal[QUATERNION], max_speed,
        )
        rests = np.tile(states[-1], (hold.times.size - len(states), 1))
        return Plan(
            PlanStatus.SOLVED if self.reaches else PlanStatus.BEST_SO_FAR,
            hold,
            np.vstack((states, rests)),
            arrival=start + arrival.duration + arrival.to_go,
            cost=arrival.error**2,
            iterations=arrival.iterations,
            kkt_residual=arrival.kkt_residual,
            message=f"arrives in {arrival.duration:.2f} s, {arrival.error:.1e} off",
            motion=self.motion,
            clearance=arrival.clearance,
            beyond=way_of_time(arrival.to_go, situation, max_speed),
        )


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


def better(
    kept: Following | None, found: Following | None, situation: Situation
) -> Following | None:
    """Return the plan to follow of the one in force and one that was found; None without any."""
    if found is None or kept is None:
        return found if kept is None else kept
    if not kept.leads_to(situation):
        return found
    if not found.leads_to(situation) or not found.reaches:
        return kept
    gain = _LEAST_GAIN * kept.solver.grid.unit
    return found if not kept.reaches or found.arrives < kept.arrives - gain else kept
