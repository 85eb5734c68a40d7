# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""States of the strategy `time_optimal`, and the plan that is followed, solved again.

`strategy.py` has the transitions between the states.
"""

import time
from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import MOMENTUM, QUATERNION, Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Arrival
from sphere_nmpc.strategy.time_optimal.planner import ArrivalPlanner
from sphere_nmpc.strategy.time_optimal.searches import earlier_arrival


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
        if self.planner.tuning.is_out_of_balance(situation):
            return self.arrival.momentum  # what differs now is planned away
        predicted = self.prediction(situation.time)[MOMENTUM]
        return situation.momentum + (self.arrival.momentum - predicted)

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


def replan(
    plan: Following, situation: Situation, dead_band: float, deadline: float,
    settings: ControllerSettings,
) -> Following | None:
    """Solve the rest of the plan again, for the same arrival time or a later one.

    Parameters
    ----------
    dead_band : float
        Error [norm in R^6] within which the sphere rests at the goal.
    deadline : float
        Steady clock reading at which to stop [s].

    Returns
    -------
    Following or None
        The rest of the plan, with the effort that an earlier arrival is worth now. None if the
        plan has ended, or no delay that is tried makes it reach the goal.
    """
    tuning, now = plan.planner.tuning, situation.time
    left = plan.time_left(now)
    if left < tuning.ended_time:
        return None
    rest, plan = plan.rest(now), replace(plan, work=0)
    change = (situation.state - plan.prediction(now))[MOMENTUM]
    if np.max(np.abs(change)) > tuning.small_momentum:
        changed = _after_change(plan, situation, rest, left, deadline)
        if changed is None:
            return None
        return replace(plan, arrival=changed, planned_at=now, work=settings.planning_effort)
    accepted = tuning.accepted_error(left / settings.period) * dead_band
    best: Arrival | None = None
    for delay in tuning.delays:
        if best is not None and time.perf_counter() > deadline:
            return replace(plan, arrival=best, planned_at=now)
        arrival = plan.planner.solve(
            situation, plan.arrival.goal, tuning.stretched(left, delay), rest, new_plan=False
        )
        found = replace(plan, arrival=arrival, planned_at=now)
        if found.reaches:
            # After a large delay the robot does not behave as the plan assumed: plan as at first.
            is_large = delay > tuning.large_delay
            fruitless = 0 if is_large else plan.fruitless
            work = settings.planning_effort // (1 if is_large else tuning.improvement_divisor)
            return replace(found, fruitless=fruitless, work=work)
        if best is None or arrival.error < 0.5 * best.error:
            best = arrival
        if best.error < accepted:
            # Too few knots are left to correct what noise has done since: a delay gains nothing.
            return replace(plan, arrival=best, planned_at=now)
    near_end = left < tuning.last_periods[0] * settings.period
    if best is None or not near_end or best.error > min(dead_band, tuning.leaving_error):
        return None
    # It ends where the sphere rests; a new plan from here would take a second or more.
    return replace(plan, arrival=best, planned_at=now)


def _after_change(
    plan: Following, situation: Situation, rest: FirstOrderHold, left: float, deadline: float
) -> Arrival | None:
    """Return an arrival with a momentum that is not the predicted one; None where none is found.

    Continuation: from the state that the plan has predicted for now, and its disturbance, those
    that are estimated are approached in steps, each solved from the arrival of the one before.
    """
    planner, tuning = plan.planner, plan.planner.tuning
    state, known = plan.prediction(situation.time), plan.arrival.disturbance.as_array()
    away = error_between(state, situation.state)
    change = situation.disturbance.as_array() - known
    arrival: Arrival | None = None
    goal, hold, duration = plan.arrival.goal, rest, left
    for share in np.linspace(0.0, 1.0, tuning.momentum_steps + 1)[1:]:
        between = replace(
            situation, state=apply_error(state, float(share) * away),
            disturbance=Disturbance.from_array(known + float(share) * change),
        )
        for delay in tuning.momentum_delays:
            if time.perf_counter() > deadline:
                return None
            arrival = planner.solve(between, goal, delay * duration, hold, new_plan=False)
            if arrival.error <= tuning.new_plan_error:
                break
        else:
            return None
        hold, duration = arrival.hold, arrival.duration
    return arrival


def improved(
    plan: Following, situation: Situation, deadline: float, settings: ControllerSettings
) -> Following:
    """Use the rest of the sample to search for an earlier arrival than that of `replan`."""
    tuning, tick, period = plan.planner.tuning, settings.control_period, settings.period
    # At a high control rate it is searched once a sample period, just after a knot.
    to_knot = plan.planner.grid.to_first_knot(situation.time, new_plan=False)
    between_knots = tick < period and to_knot < period - 0.5 * tick
    short = deadline - time.perf_counter() < tuning.least_search_time
    over = plan.fruitless >= tuning.fruitless_searches or plan.arrival.duration < tuning.fixed_time
    if over or plan.work == 0 or between_knots or short:
        return plan
    found = earlier_arrival(plan.planner, situation, plan.arrival, plan.work, deadline)
    fruitless = plan.fruitless + 1 if found.found_none else 0
    return replace(plan, arrival=found.arrival or plan.arrival, fruitless=fruitless)
