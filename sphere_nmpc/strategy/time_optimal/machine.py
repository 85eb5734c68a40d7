# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""State machine of the strategy `time_optimal`: its states, and all transitions between them.

========= ======================================================= ==========
state     condition                                               next state
========= ======================================================= ==========
Following a search has found an earlier plan, or another goal's   Following
Following the plan has not ended                                  Following
other     the rotors cannot hold the momentum at the goal         Saturated
Holding   the error is within the dead band or `leaving_error`    Holding
other     the sphere rests within the dead band                   Holding
Following the plan has ended within `leaving_error`               Holding
other     a search has found a plan                               Following
other                                                             Searching
========= ======================================================= ==========
"""

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.model.disturbance import UNDISTURBED
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import (
    MOMENTUM,
    POSITION,
    QUATERNION,
    Vector,
    nearer_sign,
    state_error,
)
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.at_rest import is_at_rest, is_saturated
from sphere_nmpc.strategy.clearance import Margin, is_clear
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.rest import hold_momentum, stop
from sphere_nmpc.strategy.time_optimal.arrival import RAISES, ArrivalSolver, rolled_out
from sphere_nmpc.strategy.time_optimal.background import BackgroundSearch, later
from sphere_nmpc.strategy.time_optimal.guide import way_of_time
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

_LEAST_GAIN = 5e-3
"""Time [1 / (c1 u_max)] by which a plan has to arrive earlier to replace the one in force."""
_ENDED = 1e-3
"""Time left of a plan [s] below which it has ended."""


@dataclass(frozen=True)
class Searching:
    """State without a plan: the rotors are ramped to rest, and a plan is searched for."""


@dataclass(frozen=True, eq=False)
class Following:
    """State in which a plan is followed.

    Attributes
    ----------
    plan : Plan
        The plan, from time 0 on; its status tells whether it ends within the dead band.
    since : float
        Control time of its time 0, the sample at which it was solved [s].
    solver : ArrivalSolver
        Solver with the drive limits of the plan.
    rested : ndarray of shape (2,), or None
        Where the sphere has rested before the plan and those that it has taken the place of [m].
    """

    plan: Plan
    since: float
    solver: ArrivalSolver
    rested: Vector | None = None

    @property
    def reaches(self) -> bool:
        """Whether the plan ends within the dead band."""
        return self.plan.status is PlanStatus.SOLVED

    @property
    def is_part(self) -> bool:
        """Whether the goal of the plan is on the way to the final one."""
        return self.plan.remaining_time > 0.0

    @property
    def arrives(self) -> float:
        """Control time of the arrival at the final goal [s], to be expected from now on."""
        return self.since + self.plan.duration + self.plan.remaining_time

    def time_left(self, now: float) -> float:
        """Return the time from `now` to the arrival [s]."""
        return self.plan.duration - (now - self.since)

    def leads_to(self, situation: Situation) -> bool:
        """Return whether the goal of a situation is that of the plan, or has changed by little.

        The change is that of where the goal will be when the plan arrives: the goal moves, or
        momentum changes the orientation that can be held.
        """
        plan = self.plan
        if plan.final is None:
            own = plan.goal.at(plan.duration)
        else:
            own = situation.orientation.nearest(plan.final, situation.goal)
        goal = situation.goal_after(self.time_left(situation.time))
        return self.solver.settings.is_near(own, goal, situation.constants)

    def prediction(self, now: float) -> Vector:
        """Return the state, shape (9,), that the plan has predicted for `now`."""
        times, states = self.plan.hold.times, self.plan.states
        elapsed = min(max(now - self.since, 0.0), self.plan.duration)
        i = max(1, int(np.searchsorted(times, elapsed)))
        share = (elapsed - times[i - 1]) / (times[i] - times[i - 1])
        state: Vector = states[i - 1] + share * (states[i] - states[i - 1])
        state[QUATERNION] /= np.linalg.norm(state[QUATERNION])
        return state

    def momentum_at_arrival(self, situation: Situation) -> Vector:
        """Return the momentum of now with what it gains until the arrival, shape (3,)."""
        if situation.is_out_of_balance:
            return self.plan.momentum  # what differs now is planned away
        predicted = self.prediction(situation.time)[MOMENTUM]
        return situation.momentum + (self.plan.momentum - predicted)

    def rest(self, now: float) -> FirstOrderHold:
        """Return what remains of the plan at `now` [s], from time 0 (now) on."""
        elapsed, hold, grid = now - self.since, self.plan.hold, self.solver.grid
        rest = hold.starting_at(elapsed, hold.at(elapsed)).delayed(-elapsed)
        return grid.thinned(grid.split(rest))

    def solved_again(
        self, situation: Situation, dead_band: float, deadline: float, is_aimed: bool = False
    ) -> "Following | None":
        """Return what remains of the plan, solved from the present state; None if it has ended.

        Parameters
        ----------
        situation : Situation
            The present one.
        dead_band : float
            Error within which the sphere rests at the goal.
        deadline : float
            Steady clock reading at which to stop [s].
        is_aimed : bool, optional
            Whether it is solved for the goal of the situation, rather than for its own.
        """
        now, settings, before = situation.time, self.solver.settings, self.plan
        if self.time_left(now) < _ENDED:
            return None
        hold = rest = self.rest(now)
        goal = self._goal_at(situation, is_aimed)
        # With noise an error is left where it would take a manoeuvre to correct it.
        noisy = settings.noisy_share * (dead_band - settings.least_dead_band)
        wanted = max(settings.arrival_error, noisy)
        for factor in RAISES:
            plan = self.solver.solve(
                situation, goal, hold, factor, deadline - time.perf_counter(), kept=True
            )
            if plan.error <= wanted or time.perf_counter() > deadline:
                break
            hold = plan.hold
        if not is_clear(situation, plan.hold, Margin.KEPT):
            # What remains of a plan that kept clear may still do so as it is.
            plan = rolled_out(replace(before, goal=goal), situation, rest)
            if not is_clear(situation, plan.hold, Margin.KEPT):
                return None
        reaches = plan.error <= max(dead_band, settings.leaving_error)
        plan = replace(
            plan, status=PlanStatus.SOLVED if reaches else PlanStatus.BEST_SO_FAR,
            remaining_time=before.remaining_time, final=before.final, motion=before.motion,
        )
        return Following(plan, now, self.solver, self.rested)

    def _goal_at(self, situation: Situation, is_aimed: bool) -> Goal:
        """Return what it is solved for in a situation, see `solved_again`, from then on."""
        own, elapsed = self.plan.goal, situation.time - self.since
        if is_aimed and not self.is_part:
            pose = nearer_sign(situation.goal_after(-elapsed), own.pose)
            own = Goal(pose, own.orientation, situation.goal_rate)
        return Goal(own.at(elapsed), own.orientation, own.rate)

    def in_control_time(self, situation: Situation, max_speed: float) -> Plan:
        """Return the plan that the loop follows, with what holds the momentum after its end.

        The rotors turn at `max_speed` [rad/s] at most.
        """
        own, plan = self.plan, self.plan.delayed(self.since)
        hold = hold_momentum(
            plan.hold, own.momentum, UNDISTURBED if own.turns else situation.disturbance,
            own.goal.pose[QUATERNION], max_speed,
        )
        rests = np.tile(own.states[-1], (hold.times.size - len(own.states), 1))
        return replace(
            plan, hold=hold, states=np.vstack((own.states, rests)), cost=own.error**2,
            message=f"a motion of {own.duration:.2f} s",
            beyond=way_of_time(own.remaining_time, situation, max_speed) if self.is_part else 0.0,
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


class Machine:
    """The state, and what follows from it at a sampling instant.

    Parameters
    ----------
    settings : ControllerSettings
        Sample period, control rate, planning effort.
    robot : RobotParameters
        Limits of the drives.
    tuning : TimeOptimalSettings
        Tuning of searches, plans and dead band.
    """

    def __init__(
        self, settings: ControllerSettings, robot: RobotParameters, tuning: TimeOptimalSettings
    ) -> None:
        self._robot, self._tuning = robot, tuning
        self.search = BackgroundSearch(settings, robot, tuning)
        """What searches for plans."""
        self.reset()

    def reset(self) -> None:
        """Forget plans and searches."""
        self.state: State = Searching()
        """The state at the last sampling instant."""
        self.search.reset()

    def forget_goal(self) -> None:
        """Search for another goal as at first; a plan is kept."""
        search = self.search
        if isinstance(self.state, Searching) and (search.no_way or search.failed):
            search.cancel()
        search.no_way = ""

    def use_attained(self, acceleration: float) -> None:
        """Plan with the acceleration [rad/s^2] that the drives attain, also what remains."""
        state, followed = self.state, self.search.solver
        self.search.use_attained(acceleration)
        if isinstance(state, Following) and state.solver is followed is not self.search.solver:
            self.state = replace(state, solver=self.search.solver)

    def advance(self, situation: Situation, deadline: float) -> State:
        """Put the next state in force and return it; a search in line stops at `deadline` [s]."""
        self.state = self._next(self.state, situation, deadline)
        return self.state

    def _next(self, state: State, situation: Situation, deadline: float) -> State:
        """Return the state that follows, by the table of the module."""
        tuning, goal, search = self._tuning, situation.goal, self.search
        dead_band = tuning.dead_band(situation.noise, situation.uncertainty)
        found = self._found(situation, dead_band, deadline)
        ended = False
        if isinstance(state, Following):
            ended = state.leads_to(situation)
            kept = state.solved_again(situation, dead_band, deadline, is_aimed=ended)
            followed = self._better(kept, found, situation)
            if followed is not None:
                return self._improved(followed, situation, dead_band, deadline)
        limit = self._robot.max_rotor_speed
        if is_saturated(situation.momentum, goal[QUATERNION], limit):
            return Saturated()
        error = state_error(situation.state, goal)
        tracked = tuning.tracked_error if situation.goal_rate.any() else 0.0
        if isinstance(state, Holding) and error < max(dead_band, state.leaving_error, tracked):
            return state
        at_rest = is_at_rest(situation, limit)
        band = max(dead_band, tracked)
        if ended or not situation.has_small_momentum:
            band = max(band, tuning.leaving_error)
        if not isinstance(state, Holding | Saturated) and at_rest and error < band:
            return Holding(tuning.leaving_band(situation.uncertainty))
        if not isinstance(state, Searching):
            search.count_anew()
        if found is None and not search.is_busy and search.may_find(situation):
            self._search(situation, at_rest, deadline)
            found = self._found(situation, dead_band, deadline)
        if found is None:
            return Searching()
        search.failed = 0
        return found

    def _better(
        self, kept: Following | None, found: Following | None, situation: Situation
    ) -> Following | None:
        """Return the plan to follow of the one in force and a found one; None without any."""
        if found is None or (kept is not None and not _replaces(found, kept, situation)):
            return kept
        self.search.failed = 0
        return found

    def _found(
        self, situation: Situation, dead_band: float, deadline: float
    ) -> Following | None:
        """Return the plan of a search whose plan begins now, solved from the present state."""
        result = self.search.take(situation.time)
        if result is None:
            return None
        task, plan = result
        since = situation.time if task.from_rest else task.situation.time
        found = Following(plan, since, task.solver, task.rested)
        return found.solved_again(situation, dead_band, deadline)

    def _search(self, situation: Situation, at_rest: bool, deadline: float) -> None:
        """Begin a search where there is no plan."""
        start, ahead = situation, self.search.ahead
        if not at_rest and ahead:
            ramp = stop(situation, self._robot, "").hold
            start = later(situation, ramp, situation.time + ahead, self.search.solver.grid.fine)
        solver, place = self.search.solver_from(situation), situation.state[POSITION]
        self.search.begin(start, solver, deadline, place, from_rest=at_rest)

    def _improved(
        self, plan: Following, situation: Situation, dead_band: float, deadline: float
    ) -> Following:
        """Begin a search for a better plan, once a sample period; return the best one so far."""
        search, now = self.search, situation.time
        if search.is_busy:
            return plan
        suits = plan.reaches and plan.leads_to(situation)
        anew = plan.is_part or not suits
        if not anew and (now <= search.next_at or self._is_improved(plan, now)):
            return plan
        hold = plan.plan.hold.delayed(plan.since)
        start = later(situation, hold, search.begins(now), plan.solver.grid.fine)
        known = None
        if not anew:
            start = replace(start, goal=nearer_sign(start.goal, plan.plan.goal.pose))
            known = plan.rest(start.time)
        rested = plan.rested if suits else None
        search.improved_at = now
        search.begin(start, plan.solver, deadline, rested, known=known, is_new=plan.is_part)
        if search.ahead:
            return plan
        found = self._found(situation, dead_band, deadline)
        return self._better(plan, found, situation) or plan

    def _is_improved(self, plan: Following, now: float) -> bool:
        """Return whether no earlier arrival is searched for any more."""
        return not plan.is_part and (
            self.search.failed >= self._tuning.failed_searches
            or plan.time_left(self.search.begins(now)) < 2.0 * plan.solver.grid.spacing
        )

    def until(self, situation: Situation) -> float:
        """Return the control time before which no other plan is wanted [s] if nothing is new."""
        state, now = self.state, situation.time
        until = self.search.a_period_after(now)
        if isinstance(state, Holding):
            return -math.inf if situation.goal_rate.any() else until
        if not isinstance(state, Following) or not state.reaches:
            return -math.inf
        if not self.search.is_busy and not self._is_improved(state, now):
            if state.is_part:
                return -math.inf
            until = self.search.next_at
        return min(until, state.since + state.plan.duration)


def _replaces(found: Following, kept: Following, situation: Situation) -> bool:
    """Return whether a plan that was found is followed instead of the one in force."""
    if not kept.leads_to(situation):
        return True
    if not found.leads_to(situation) or not found.reaches:
        return False
    gain = _LEAST_GAIN * kept.solver.grid.unit
    return not kept.reaches or found.arrives < kept.arrives - gain
