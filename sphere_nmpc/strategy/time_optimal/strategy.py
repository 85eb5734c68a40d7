# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time-optimal control with a shrinking horizon: a plan is followed to its end, then held.

At a new goal the earliest arrival that a search finds is planned. What is left of the plan is
solved again from the measured state once a sample period, and whenever something is new; the
duration is a variable, so that a disturbance changes the time of the arrival. Once a sample period
a search looks for an earlier one. At the goal the rotors rest; small errors are corrected by
rolling, larger ones by a new plan.
``docs/strategy.md`` has the stability argument.

With momentum the sphere rests where the rotors hold it. A goal at which they cannot is replaced by
the nearest one; momentum of a sphere out of balance is unloaded before the rotors saturate; and
where they are saturated by a slope they stay at their limits until it ends.
"""

import dataclasses
import itertools
import time

import numpy as np

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, nearer_sign, state_error
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.clearance import stop_before_contact
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus, Unreachable
from sphere_nmpc.strategy.rest import (
    SATURATED,
    come_to_rest,
    is_saturated,
    speeds_of_rest,
    stop,
)
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver
from sphere_nmpc.strategy.time_optimal.goals import HeldGoal
from sphere_nmpc.strategy.time_optimal.holding import RestAtGoal
from sphere_nmpc.strategy.time_optimal.searches import (
    Searches,
    SearchTask,
    later,
    solver_for,
)
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.states import (
    Following,
    Holding,
    Saturated,
    Searching,
    State,
    better,
    is_near,
)
from sphere_nmpc.worker.contract import Worker
from sphere_nmpc.worker.in_line import InLine

_MANY = 8
"""Searches without an arrival from which on that is told."""


class TimeOptimalStrategy:
    """`Strategy` of the earliest arrival that a search finds.

    Parameters
    ----------
    settings : ControllerSettings
        Sample period, control rate, planning effort; weights of corrections at the goal.
    robot : RobotParameters
        Limits of the drives.
    tuning : TimeOptimalSettings, optional
        Tuning of searches, plans and dead band.
    """

    def __init__(
        self, settings: ControllerSettings, robot: RobotParameters,
        tuning: TimeOptimalSettings | None = None,
    ) -> None:
        self._settings = settings
        self._robot = robot
        self._tuning = TimeOptimalSettings() if tuning is None else tuning
        self._held_goal = HeldGoal(robot.max_rotor_speed, self._tuning)
        self._rest_at_goal = RestAtGoal(settings, robot, self._tuning)
        self._in_line = Searches(InLine())
        self._beside: Searches | None = None
        self.reset()

    def search_beside(self, worker: Worker) -> None:
        """Search by a worker from now on, and follow the plan meanwhile.

        A changed goal is then found by comparison, and needs no `reset`: the plan in force is
        followed until there is one to the new goal.
        """
        tuning = self._tuning
        self._beside = Searches(worker, tuning.search_ahead, 2.0 * tuning.longest_search)

    def is_due(self, now: float) -> bool:
        """Return whether a search has ended whose plan begins at `now` [s] or before."""
        return self._beside is not None and self._beside.is_due(now)

    @property
    def searches(self) -> bool:
        """Whether a plan is being searched for beside the loop, other than an earlier arrival."""
        task = None if self._beside is None else self._beside.task
        return task is not None and task.known is None

    def change(self, settings: ControllerSettings) -> None:
        """Use another planning effort and other weights; plan and started search are kept."""
        self._settings = settings
        self._rest_at_goal.change(settings)

    def reset(self) -> None:
        """Forget plans and searches; the strategy then behaves like a new one."""
        self._state: State = Searching()
        self._last: Situation | None = None
        self._improved_at = -np.inf
        self._no_way = ""
        self._no_way_on: Floor | None = None
        for searches in (self._in_line, self._beside):
            if searches is not None:
                searches.cancel()
        self._seeds = itertools.count(1)
        self._solver = self._solver_with(1.0)
        self._forget_goal()

    def _forget_goal(self) -> None:
        for part in (self._held_goal, self._rest_at_goal):
            part.reset()

    def _solver_with(self, share: float) -> ArrivalSolver:
        """Return a solver with this share of the limit of the rotors' acceleration."""
        limit = share * self._robot.max_rotor_acceleration
        robot = dataclasses.replace(self._robot, max_rotor_acceleration=limit)
        return solver_for(robot, self._tuning)

    def _use_attained(self, situation: Situation) -> None:
        """Plan with the acceleration that the drives attain, also what remains of a plan."""
        tuning, limit = self._tuning, self._robot.max_rotor_acceleration
        share = min(1.0, tuning.attained_share * situation.acceleration / limit)
        share = max(share, tuning.slip_acceleration)
        before = self._solver.robot.max_rotor_acceleration / limit
        if abs(share - before) <= (1.0 - tuning.attained_share) * share:
            return
        followed, self._solver = self._solver, self._solver_with(share)
        state = self._state
        if isinstance(state, Following) and state.solver is followed:
            self._state = dataclasses.replace(state, solver=self._solver)

    def plan(self, situation: Situation) -> Plan:
        """Follow the plan, search for a new one, or rest at the goal."""
        began = time.perf_counter()
        situation = self._with_member(situation)
        if self._is_other_goal(situation):
            self._forget_goal()
            if isinstance(self._state, Searching) and (self._no_way or self._state.fruitless):
                self._state = Searching()
                self._searches.cancel()
            self._no_way = ""
        self._last = situation
        self._use_attained(situation)
        situation = self._aimed(situation)
        self._state = self._next(self._state, situation, began + situation.time_budget)
        plan = self._plan_of(self._state, situation)
        plan = dataclasses.replace(
            plan, until=self._until(situation), tolerance=self._tuning.arrival_error
        )
        if not plan.given_up and self._held_goal.given_up:
            plan = dataclasses.replace(plan, given_up=self._held_goal.given_up)
        if isinstance(self._state, Holding):
            return plan
        return dataclasses.replace(plan, solve_time=time.perf_counter() - began)

    def _until(self, situation: Situation) -> float:
        """Return the control time before which no other plan is wanted [s] if nothing is new."""
        state, now, settings = self._state, situation.time, self._settings
        until = now + settings.period - 0.5 * settings.control_period
        if isinstance(state, Holding):
            return -np.inf if situation.goal_rate.any() else until
        if not isinstance(state, Following) or not state.reaches:
            return -np.inf
        searches = self._searches.task is None and not self._is_improved(state, situation)
        if searches and state.is_part:
            return -np.inf
        if searches:
            until = self._improved_at + settings.period - 0.5 * settings.control_period
        return min(until, state.planned_at + state.arrival.duration)

    def _plan_of(self, state: State, situation: Situation) -> Plan:
        if isinstance(state, Holding):
            return self._rest_at_goal.plan(situation)
        if isinstance(state, Following):
            return state.as_plan(situation, self._robot.max_rotor_speed)
        robot = self._robot
        if isinstance(state, Saturated):
            status = PlanStatus.SATURATED
            plan = come_to_rest(situation, robot, "saturated", status)
            return dataclasses.replace(plan, given_up=SATURATED)
        plan = self._stop(situation)
        if self._no_way:
            lasts = situation.floor.lasting is situation.floor
            return dataclasses.replace(
                plan, given_up=self._no_way, message="no way to the goal",
                unreachable=Unreachable.NO_WAY if lasts else None,
            )
        given_up = stop_before_contact(situation, plan.hold)
        if not given_up and state.fruitless >= _MANY:
            given_up = "the goal for now: no motion to it was found from here"
        return dataclasses.replace(plan, given_up=given_up)

    def _stop(self, situation: Situation) -> Plan:
        return stop(situation, self._robot, "no arrival found yet")

    def _next(self, state: State, situation: Situation, deadline: float) -> State:
        """Return the state that follows from `state` and the present situation.

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
        tuning, goal = self._tuning, situation.goal
        dead_band = tuning.dead_band(situation.noise, situation.uncertainty)
        error = state_error(situation.state, goal)
        found, is_fruitless = self._found(situation, dead_band, deadline)
        ended = False
        if isinstance(state, Following):
            ended = state.leads_to(situation)
            plan = state.aimed_at(situation) if ended else state
            kept = plan.solved_again(situation, dead_band, deadline)
            if kept is not None and is_fruitless:
                kept = dataclasses.replace(kept, fruitless=kept.fruitless + 1)
            followed = better(kept, found, situation)
            if followed is not None:
                return self._searched_beyond(followed, situation, dead_band, deadline)
            state = Searching()
        if is_saturated(situation.momentum, goal[QUATERNION], self._robot.max_rotor_speed):
            return Saturated()
        tracked = tuning.tracked_error if situation.goal_rate.any() else 0.0
        if isinstance(state, Holding) and error < max(dead_band, state.leaving_error, tracked):
            return state
        at_rest = self._is_at_rest(situation)
        band = max(dead_band, tracked)
        if ended or not tuning.is_small(situation):
            band = max(band, tuning.leaving_error)
        if not isinstance(state, Holding | Saturated) and at_rest and error < band:
            return Holding(tuning.leaving_band(situation.uncertainty))
        self._rest_at_goal.reset()
        fruitless = state.fruitless if isinstance(state, Searching) else 0
        fruitless = fruitless + 1 if is_fruitless else fruitless
        if found is None and self._searches.task is None and self._may_find(situation):
            found, is_fruitless = self._searched_anew(
                situation, fruitless, at_rest, dead_band, deadline
            )
            fruitless = fruitless + 1 if is_fruitless else fruitless
        return Searching(fruitless) if found is None else found

    def _may_find(self, situation: Situation) -> bool:
        """Return whether to search; where there was no way on this floor, once a sample period."""
        if not self._no_way or self._no_way_on is not situation.floor:
            return True
        now = situation.time
        is_due = self._is_idle(now)
        if is_due:
            self._improved_at = now
        return is_due

    def _is_idle(self, now: float) -> bool:
        """Return whether the last search of its kind began a sample period ago [s]."""
        settings = self._settings
        return now > self._improved_at + settings.period - 0.5 * settings.control_period

    @property
    def _searches(self) -> Searches:
        """The searches of the worker; in line where there is none to be had."""
        beside = self._beside
        return beside if beside is not None and beside.available else self._in_line

    def _found(
        self, situation: Situation, dead_band: float, deadline: float
    ) -> tuple[Following | None, bool]:
        """Return the plan of a search whose plan begins now, and whether one was fruitless."""
        outcome = self._searches.take(situation.time, self._settings.control_period)
        if outcome is None:
            return None, False
        self._no_way, self._no_way_on = outcome.reason, outcome.task.situation.floor
        if outcome.arrival is None:
            return None, not outcome.reason
        begins = situation.time if outcome.task.from_rest else outcome.task.situation.time
        task = outcome.task
        plan = Following(
            outcome.arrival, begins, solver_for(task.robot, self._tuning), motion=task.seed,
            final=task.situation.goal if outcome.arrival.to_go > 0.0 else None,
            rested=task.rested,
        )
        return plan.solved_again(situation, dead_band, deadline), False

    def _search(
        self, start: Situation, solver: ArrivalSolver, effort: int, longest: float,
        plan: Following | None = None, from_rest: bool = False, fruitless: int = 0,
        rested: Vector | None = None,
    ) -> None:
        """Begin a search from a situation on, for an earlier arrival if there is a plan."""
        known = None if plan is None else plan.rest(start.time)
        task = SearchTask(
            solver.robot, self._tuning, start, next(self._seeds), effort, longest, from_rest,
            known, fruitless, rested,
        )
        self._searches.begin(task)

    def _searched_anew(
        self, situation: Situation, fruitless: int, at_rest: bool, dead_band: float,
        deadline: float,
    ) -> tuple[Following | None, bool]:
        """Begin a search where there is no plan; return what it has found in line."""
        tuning, searches = self._tuning, self._searches
        start = situation
        if not at_rest and searches.ahead:
            ramp = self._stop(situation).hold
            start = later(situation, ramp, situation.time + searches.ahead, self._solver.grid.fine)
        # In motion the next search has another problem, which may be easier.
        growth = tuning.growth(fruitless) if at_rest else 1.0
        solver = self._solver
        if situation.slippery:
            solver = self._solver_with(tuning.slip_acceleration)
        longest = self._longest(growth, deadline)
        effort = round(growth * self._settings.planning_effort)
        self._search(
            start, solver, effort, longest, from_rest=at_rest, fruitless=fruitless,
            rested=situation.state[POSITION],
        )
        return self._found(situation, dead_band, deadline)

    def _longest(self, growth: float, deadline: float) -> float:
        """Return the wall time of a search [s]."""
        if self._searches is self._in_line:
            return deadline - time.perf_counter()
        return growth * self._tuning.longest_search

    def _searched_beyond(
        self, plan: Following, situation: Situation, dead_band: float, deadline: float
    ) -> Following:
        """Begin a search for a better plan, once a sample period; return the best one so far."""
        settings, now = self._settings, situation.time
        searches = self._searches
        begins = self._begins(now)
        suits = plan.reaches and plan.leads_to(situation)
        over = suits and self._is_improved(plan, situation)
        idle = plan.is_part or self._is_idle(now)
        if searches.task is not None or over or not (idle or not suits):
            return plan
        self._improved_at = now
        start = later(
            situation, plan.arrival.hold.delayed(plan.planned_at), begins, plan.solver.grid.fine
        )
        if suits and not plan.is_part:
            start = dataclasses.replace(start, goal=nearer_sign(start.goal, plan.arrival.goal))
        known = plan if suits and not plan.is_part else None
        longest = self._longest(1.0, deadline)
        self._search(
            start, plan.solver, settings.planning_effort, longest, known,
            fruitless=plan.fruitless if plan.is_part else 0,
            rested=plan.rested if suits else None,
        )
        if searches.ahead:
            return plan
        found, is_fruitless = self._found(situation, dead_band, deadline)
        if is_fruitless:
            return dataclasses.replace(plan, fruitless=plan.fruitless + 1)
        return better(plan, found, situation) or plan

    def _begins(self, now: float) -> float:
        """Return the control time at which the plan of a search that begins now starts [s]."""
        ahead = self._searches.ahead
        return now + (max(ahead, self._settings.control_period) if ahead else 0.0)

    def _is_improved(self, plan: Following, situation: Situation) -> bool:
        """Return whether no earlier arrival is searched for any more."""
        return not plan.is_part and (
            plan.fruitless >= self._tuning.fruitless_searches
            or plan.time_left(self._begins(situation.time)) < 2.0 * plan.solver.grid.spacing
        )

    def _is_at_rest(self, situation: Situation) -> bool:
        """Return whether the rotors turn at the speeds at which the sphere rests."""
        in_force, tuning = situation.input_in_force, self._tuning
        turn, limit = situation.state[QUATERNION], self._robot.max_rotor_speed
        held = speeds_of_rest(situation.momentum, turn, limit)
        return bool(np.all(np.abs(in_force - held) < tuning.small_momentum))

    def _is_other_goal(self, situation: Situation) -> bool:
        """Return whether the goal is another one than the last, which may have moved."""
        last, orientation = self._last, situation.orientation
        if last is None or last.orientation is not orientation:
            return True
        moved = last.goal_after(situation.time - last.time)
        moved = orientation.nearest(moved, situation.goal)
        return not is_near(moved, situation.goal, situation.constants, self._tuning)

    def _with_member(self, situation: Situation) -> Situation:
        """Return the situation with the member of the goals that is nearest to the plan's end.

        Without a plan that is the one nearest to the present state.
        """
        if situation.orientation is Orientation.FULL:
            return situation
        near = self._state.arrival.goal if isinstance(self._state, Following) else situation.state
        goal = situation.orientation.nearest(situation.goal, near)
        return dataclasses.replace(situation, goal=goal)

    def _aimed(self, situation: Situation) -> Situation:
        """Return the situation with a goal that can be held."""
        state, end = self._state, None
        if isinstance(state, Following):
            end = state.momentum_at_arrival(situation)
        found_none = isinstance(state, Searching) and state.fruitless > 0
        goal = self._held_goal.goal(situation, end, isinstance(state, Holding), found_none)
        return situation if goal is situation.goal else dataclasses.replace(situation, goal=goal)
