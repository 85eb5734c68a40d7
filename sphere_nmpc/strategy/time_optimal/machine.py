# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""State machine of the strategy `time_optimal`: its states, and all transitions between them.

========= ======================================================= ==========
state     condition                                               next state
========= ======================================================= ==========
Following the leg of the next plan in the chain is followed       Following
Following a search has found an earlier plan, or another goal's   Following
Following the plan has not ended                                  Following
other     the rotors cannot hold the momentum at the goal         Saturated
Holding   the error is within the dead band or `leaving_error`    Holding
other     the sphere rests within the dead band                   Holding
Following the plan has ended within `leaving_error`               Holding
other     a search has found a plan                               Following
other                                                             Searching
========= ======================================================= ==========

While a plan is followed, that of the next leg of the course is searched for from its end on, and
follows it in the chain.
"""

import math
from dataclasses import dataclass, replace

from sphere_nmpc.model.course import LegEnd
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, QUATERNION, nearer_sign, state_error
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.at_rest import is_at_rest, is_saturated
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.in_force import InForce
from sphere_nmpc.strategy.plan import PlanStatus
from sphere_nmpc.strategy.rest import stop
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver
from sphere_nmpc.strategy.time_optimal.background import BackgroundSearch
from sphere_nmpc.strategy.time_optimal.chain import later
from sphere_nmpc.strategy.time_optimal.following import (
    at_its_end,
    leads_to,
    left_of,
    next_leg,
    solved_again,
)
from sphere_nmpc.strategy.time_optimal.search_task import solver_for
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

_MIN_GAIN = 5e-3
"""Time [1 / (c1 u_max)] by which a plan has to arrive earlier to replace the one in force."""


@dataclass(frozen=True)
class Searching:
    """State without a plan: the rotors are ramped to rest, and a plan is searched for."""


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


State = Searching | InForce | Holding | Saturated
"""State of following is an `InForce`; whether it ends in the dead band is its plan's status."""


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
        self._found_next: InForce | None = None
        self._leg_began = math.nan
        self.search.reset()

    def forget_goal(self) -> None:
        """Search for another goal as at first; a plan is kept."""
        search = self.search
        if isinstance(self.state, Searching) and (search.no_way or search.failed):
            search.cancel()
        search.no_way, self._leg_began = "", math.nan

    def use_attained(self, acceleration: float) -> None:
        """Plan with the acceleration [rad/s^2] that the drives attain, also what remains."""
        state, before = self.state, self.search.solver.robot
        self.search.use_attained(acceleration)
        if isinstance(state, InForce) and state.robot is before is not self.search.solver.robot:
            self.state = replace(state, robot=self.search.solver.robot)

    def enter_leg(self, situation: Situation) -> State:
        """Follow the plan of the next leg where that is the one of the situation now."""
        before = self.state
        if isinstance(before, InForce):
            self.state = before.on_leg(situation)
            if self.state is not before:
                self.search.begin_leg()
                self._leg_began = before.plan.end
        if math.isnan(self._leg_began):
            self._leg_began = situation.time
        return self.state

    def advance(self, situation: Situation, deadline: float) -> State:
        """Put the next state in force and return it; a search in line stops at `deadline` [s]."""
        self.state = self._next(self.state, situation, deadline)
        return self.state

    def _next(self, state: State, situation: Situation, deadline: float) -> State:
        """Return the state that follows, by the table of the module."""
        tuning, goal, search = self._tuning, situation.goal.pose, self.search
        dead_band = tuning.dead_band(situation.plant.noise, situation.uncertainty)
        found = self._found(situation, dead_band, deadline)
        ended = False
        if isinstance(state, InForce):
            ended = self._leads_to(state, situation)
            kept = solved_again(
                state, situation, self._solver_of(state), dead_band, deadline, is_aimed=ended
            )
            followed = self._better(kept, found, situation)
            if followed is not None:
                leads = (ended and followed is kept) or self._leads_to(followed, situation)
                suits = leads and _reaches(followed)
                followed = self._improved(followed, situation, dead_band, deadline, suits)
                return self._with_next(followed, situation, dead_band, deadline)
        limit = self._robot.max_rotor_speed
        if is_saturated(situation.momentum, goal[QUATERNION], limit):
            return Saturated()
        error = state_error(situation.state, goal)
        tracked = tuning.tracked_error if situation.goal.rate.any() else 0.0
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

    def _solver_of(self, followed: InForce) -> ArrivalSolver:
        """Return the solver with the limits of the drives that a plan keeps."""
        return solver_for(followed.robot, self._tuning)

    def _leads_to(self, followed: InForce, situation: Situation) -> bool:
        return leads_to(followed, situation, self._tuning)

    def _better(
        self, kept: InForce | None, found: InForce | None, situation: Situation
    ) -> InForce | None:
        """Return the plan to follow of the one in force and a found one; None without any."""
        if found is None or (kept is not None and not self._replaces(found, kept, situation)):
            return kept
        self.search.failed = 0
        return found if kept is None else replace(found, after=kept.after)

    def _replaces(self, found: InForce, kept: InForce, situation: Situation) -> bool:
        """Return whether a plan that was found is followed instead of the one in force."""
        if not self._leads_to(kept, situation):
            return True
        if not self._leads_to(found, situation) or not _reaches(found):
            return False
        gain = _MIN_GAIN * self._solver_of(kept).grid.unit
        return not _reaches(kept) or found.plan.cost < kept.plan.cost - gain

    def _found(
        self, situation: Situation, dead_band: float, deadline: float
    ) -> InForce | None:
        """Return the plan of a search whose plan begins now, solved from the present state."""
        taken = self.search.take(situation.time)
        if taken is None:
            return None
        found, is_next = taken
        if is_next:
            self._found_next = found
            return None
        return solved_again(found, situation, self._solver_of(found), dead_band, deadline)

    def _with_next(
        self, followed: InForce, situation: Situation, dead_band: float, deadline: float
    ) -> InForce:
        """Return a plan with that of the next leg: a found one where it is the shorter one."""
        found, self._found_next = self._found_next, None
        if found is None and followed.after is None:
            return followed
        plans = list[InForce]()
        if _ends_leg(followed, situation) and self._leads_to(followed, situation):
            for one in filter(None, (followed.after, found)):
                solver = self._solver_of(one)
                after = next_leg(
                    replace(followed, after=one), situation, solver, dead_band, deadline
                )
                plans += [] if after is None else [after]
        shortest = min(plans, key=lambda one: one.plan.cost, default=None)
        return replace(followed, after=shortest)

    def _begin_next(self, followed: InForce, situation: Situation, deadline: float) -> None:
        """Begin a search for the next leg, or for a shorter plan of it."""
        search, after, start = self.search, followed.after, at_its_end(followed, situation)
        if after is None:
            solver, known, spared = search.solver_from(situation), None, 0.0
            start = start.nearest_to(start.state)
        else:
            solver = self._solver_of(after)
            start = start.aimed_at(start.aim(after.plan.leg.goal.pose))
            spared = after.plan.spared
            known = replace(after.plan, hold=left_of(after.plan, start.time, solver.grid))
        search.improved_at = situation.time
        search.begin(
            start, solver, deadline, start.state[POSITION], from_rest=True, known=known,
            is_next=True, leg_began=start.time, spared=spared,
        )

    def _search(self, situation: Situation, at_rest: bool, deadline: float) -> None:
        """Begin a search where there is no plan."""
        search, start = self.search, situation
        if not at_rest:
            ramp, begins = stop(situation, self._robot, "").hold, situation.time + search.ahead
            start = later(situation, ramp, begins, search.solver.grid.fine)
        solver, place = search.solver_from(situation), situation.state[POSITION]
        search.begin(
            start, solver, deadline, place, from_rest=at_rest, leg_began=self._leg_began
        )

    def _improved(
        self, followed: InForce, situation: Situation, dead_band: float, deadline: float,
        suits: bool,
    ) -> InForce:
        """Begin a search for a better plan, once a sample period; return the best one so far.

        One `suits` that ends at the goal, or on the way there.
        """
        search, now, plan = self.search, situation.time, followed.plan
        if search.is_busy:
            return followed
        if suits and self._lacks_next(followed, situation):
            self._begin_next(followed, situation, deadline)
            self._found(situation, dead_band, deadline)
            return followed
        is_passed = plan.leg.end is LegEnd.THROUGH
        waits = suits and not is_passed
        if waits and (now <= search.next_at or self._is_improved(followed, now)):
            return followed
        solver, known = self._solver_of(followed), None
        start = later(situation, plan.hold, search.begins(now), solver.grid.fine)
        if suits:
            known = replace(plan, hold=left_of(plan, start.time, solver.grid))
        if waits:
            pose = nearer_sign(start.goal.pose, plan.leg.goal.pose)
            start = start.aimed_at(start.aim(pose))
        rested = followed.rested if suits else None
        search.improved_at = now
        search.begin(
            start, solver, deadline, rested, known=known, is_new=is_passed,
            leg_began=self._leg_began, spared=plan.spared,
        )
        if search.ahead:
            return followed
        found = self._found(situation, dead_band, deadline)
        return self._better(followed, found, situation) or followed

    def _lacks_next(self, followed: InForce, situation: Situation) -> bool:
        """Return whether a plan of the next leg is to be searched for, or a shorter one.

        The latter only once no earlier arrival is searched for.
        """
        search, now = self.search, situation.time
        if not _ends_leg(followed, situation):
            return False
        if search.failed_ahead >= self._tuning.failed_searches:
            return False
        if followed.after is None:
            return self._found_next is None
        return now > search.next_at and self._is_improved(followed, now)

    def _is_improved(self, followed: InForce, now: float) -> bool:
        """Return whether no earlier arrival is searched for any more."""
        left = followed.plan.end - self.search.begins(now)
        return followed.plan.leg.end is LegEnd.REST and (
            self.search.failed >= self._tuning.failed_searches
            or left < 2.0 * self._solver_of(followed).grid.spacing
        )

    def until(self, situation: Situation) -> float:
        """Return the control time before which no other plan is wanted [s] if nothing is new."""
        state = self.state
        now = since = situation.time
        if isinstance(state, Holding):
            return -math.inf if situation.goal.rate.any() else self.search.a_period_after(now)
        if not isinstance(state, InForce) or not _reaches(state):
            return -math.inf
        if not self.search.is_busy:
            lacks_next = self._lacks_next(state, situation)
            if state.plan.leg.end is LegEnd.THROUGH or (lacks_next and state.after is None):
                return -math.inf
            if lacks_next or not self._is_improved(state, now):
                since = self.search.improved_at
        return min(self.search.a_period_after(since), state.plan.end)


def _ends_leg(followed: InForce, situation: Situation) -> bool:
    """Return whether a plan ends at a goal with another leg after it."""
    if situation.leg == len(situation.course.legs) - 1:
        return False
    return followed.plan.leg.end is LegEnd.REST and _reaches(followed)


def _reaches(followed: InForce) -> bool:
    """Return whether a plan ends within the dead band."""
    return followed.plan.status is PlanStatus.SOLVED
