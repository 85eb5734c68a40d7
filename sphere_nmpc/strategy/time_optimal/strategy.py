# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time-optimal control with a shrinking horizon: plan once, arrive on time, then hold.

At a new goal the earliest arrival that a search finds is planned. At each later sample the rest
of the plan is solved again from the measured state, with one interval less; if it can no longer
reach the goal in time, the arrival is delayed a little. At the goal the rotors rest; small errors
are corrected by rolling, larger ones by a new plan. ``docs/strategy.md`` has the stability
argument.

With momentum the sphere rests where the rotors hold it. A goal at which they cannot is replaced by
the nearest one; momentum of a sphere out of balance is unloaded before the rotors saturate; and
where they are saturated by a slope they stay at their limits until it ends.
"""

import dataclasses
import itertools
import time

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import (
    POSITION,
    QUATERNION,
    Vector,
    angle_error,
    nearer_sign,
    state_error,
)
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.rest import (
    SATURATED,
    hold_momentum,
    is_saturated,
    speeds_of_rest,
)
from sphere_nmpc.strategy.time_optimal.goals import HeldGoal, IntermediateGoals
from sphere_nmpc.strategy.time_optimal.holding import RestAtGoal, come_to_rest
from sphere_nmpc.strategy.time_optimal.planner import ArrivalPlanner, KnotGrid
from sphere_nmpc.strategy.time_optimal.searches import (
    Purpose,
    SearchesBeside,
    SearchResult,
    WorkerSearch,
    later,
    search_task,
)
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.states import (
    Following,
    Holding,
    Saturated,
    Searching,
    State,
    improved,
    replan,
)
from sphere_nmpc.worker.contract import Worker


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
        self._goals = IntermediateGoals(self._tuning)
        self._held_goal = HeldGoal(robot.max_rotor_speed, self._tuning)
        self._rest_at_goal = RestAtGoal(settings, robot, self._tuning)
        self._beside: SearchesBeside | None = None
        self.reset()

    def search_beside(self, worker: Worker) -> None:
        """Search by a worker from now on, and follow the plan meanwhile.

        A changed goal is then found by comparison, and needs no `reset`: the plan in force is
        followed until there is one to the new goal.
        """
        self._beside = SearchesBeside(worker, self._tuning)

    def is_due(self, now: float) -> bool:
        """Return whether a search has ended whose plan begins at `now` [s] or before."""
        return self._beside is not None and self._beside.is_due(now)

    @property
    def searches(self) -> bool:
        """Whether a plan is being searched for beside the loop, other than an earlier arrival."""
        beside = self._beside
        return beside is not None and beside.purpose in (Purpose.NEW, Purpose.REDIRECT)

    def change(self, settings: ControllerSettings) -> None:
        """Use another planning effort and other weights; plan and started search are kept."""
        self._settings = settings
        self._rest_at_goal.change(settings)

    def reset(self) -> None:
        """Forget plans and searches; the strategy then behaves like a new one."""
        self._state: State = Searching()
        self._goal: Vector | None = None
        self._improved_at = -np.inf
        if self._beside is not None:
            self._beside.cancel()
        self._grid = KnotGrid(self._settings.period, self._tuning)
        self._seeds = itertools.count(1)
        limit = self._robot.max_rotor_acceleration
        self._acceleration = limit
        self._full = self._planner(limit)
        self._slippery = self._planner(self._tuning.slip_acceleration * limit)
        self._goals.reset()
        self._held_goal.reset()
        self._rest_at_goal.reset()

    def _planner(self, acceleration: float) -> ArrivalPlanner:
        """Return a planner with this limit of the rotors' acceleration [rad/s^2]."""
        robot = dataclasses.replace(self._robot, max_rotor_acceleration=acceleration)
        return ArrivalPlanner(robot, self._settings.period, self._grid, self._seeds, self._tuning)

    def _use_attained(self, situation: Situation) -> None:
        """Plan with the acceleration that the drives attain, also what remains of a plan."""
        share = self._tuning.attained_share
        limit = min(self._robot.max_rotor_acceleration, share * situation.acceleration)
        limit = max(limit, self._tuning.slip_acceleration * self._robot.max_rotor_acceleration)
        if abs(limit - self._acceleration) <= self._tuning.same_acceleration * limit:
            return
        followed, self._acceleration, self._full = self._full, limit, self._planner(limit)
        state = self._state
        if isinstance(state, Following) and state.planner is followed:
            self._state = dataclasses.replace(state, planner=self._full)

    def plan(self, situation: Situation) -> Plan:
        """Follow the plan, search for a new one, or rest at the goal."""
        began = time.perf_counter()
        self._grid.begin(situation.time)
        self._use_attained(situation)
        if self._beside is not None:
            situation = self._with_goal_of_plan(situation, self._beside)
        situation = self._aim(self._holdable(situation))
        self._state = self._next(self._state, situation, began + situation.time_budget)
        plan = self._plan_of(self._state, situation)
        if not plan.given_up and self._held_goal.given_up:
            plan = dataclasses.replace(plan, given_up=self._held_goal.given_up)
        if isinstance(self._state, Holding):
            return plan
        return dataclasses.replace(plan, solve_time=time.perf_counter() - began)

    def _plan_of(self, state: State, situation: Situation) -> Plan:
        if isinstance(state, Holding):
            return self._rest_at_goal.plan(situation)
        if isinstance(state, Following):
            return self._as_plan(state)
        robot, rest_time = self._robot, self._tuning.rest_time
        if isinstance(state, Saturated):
            status = PlanStatus.SATURATED
            plan = come_to_rest(situation, robot, rest_time, "saturated", status)
            return dataclasses.replace(plan, given_up=SATURATED)
        status = PlanStatus.RAMP_TO_REST
        return come_to_rest(situation, robot, rest_time, "no arrival found yet", status)

    def _next(self, state: State, situation: Situation, deadline: float) -> State:
        """Return the state that follows from `state` and the present situation.

        Following -> Following while the rest of the plan reaches the goal. A plan that has ended,
        or can no longer reach it, ends in Holding if the sphere rests within the dead band, else
        in a search. Holding -> Searching when the error leaves the dead band. Searching ->
        Following once there is a plan, -> Holding if the sphere rests within the dead band. Any
        but Following -> Saturated while the rotors cannot hold the momentum at the goal, and back
        -> Searching.
        """
        tuning, settings = self._tuning, self._settings
        dead_band = tuning.dead_band(situation.noise, situation.uncertainty)
        if isinstance(state, Following):
            followed = self._followed(state, situation, dead_band, deadline)
            if followed is not None:
                return followed
            state = Searching()
        limit = self._robot.max_rotor_speed
        if is_saturated(situation.momentum, situation.goal[QUATERNION], limit):
            return Saturated()
        if isinstance(state, Saturated):
            state = Searching()
        error = state_error(situation.state, situation.goal)
        at_rest = self._is_at_rest(situation)
        if isinstance(state, Holding):
            if error < max(dead_band, state.leaving_error):
                return state
            state = Searching()
        elif at_rest and error < self._resting_band(dead_band, situation):
            return Holding(tuning.leaving_band(situation.uncertainty))
        self._rest_at_goal.reset()
        if self._beside is not None and self._beside.available:
            return self._found_beside(state, situation, self._beside, at_rest, dead_band, deadline)
        planner, now = self._planner_for(situation), situation.time
        task = search_task(
            planner, situation, self._grid.origin(now),
            round(self._growth(state, situation, at_rest) * settings.planning_effort),
            deadline - time.perf_counter(), state.strict,
        )
        return self._planned(task(), state, planner, now)

    def _planner_for(self, situation: Situation) -> ArrivalPlanner:
        """Return the planner with the limit of acceleration that the floor allows."""
        return self._slippery if situation.slippery else self._full

    def _growth(self, state: Searching, situation: Situation, at_rest: bool) -> float:
        """Return the factor [-] on the effort of a search for a plan where there is none."""
        # In motion the next search has another problem, which may be easier.
        return self._tuning.growth(state.fruitless) if at_rest else 1.0

    def _planned(
        self, result: SearchResult, state: Searching, planner: ArrivalPlanner, begins: float
    ) -> Searching | Following:
        """Return the state after a search for a plan that begins at `begins` [s]."""
        if result.arrival is None:
            strict = state.strict or not result.found_none
            return Searching(strict, state.fruitless + 1 if result.found_none else 0)
        return Following(result.arrival, begins, planner)

    def _followed(
        self, state: Following, situation: Situation, dead_band: float, deadline: float
    ) -> Following | None:
        """Return what remains of the plan, or of an earlier arrival; None if it has ended."""
        settings, beside = self._settings, self._beside

        def rest(plan: Following) -> Following | None:
            return replan(plan, situation, dead_band, deadline, settings)

        if beside is None or not beside.available:
            kept = rest(state)
            return None if kept is None else improved(kept, situation, deadline, settings)
        followed: Following | None = None
        if beside.purpose is Purpose.EARLIER:
            outcome = beside.take(situation.time, settings.control_period)
            if outcome is not None and not outcome.is_late:
                arrival, begins = outcome.result.arrival, outcome.situation.time
                if arrival is None:
                    state = dataclasses.replace(state, fruitless=state.fruitless + 1)
                else:
                    followed = rest(Following(arrival, begins, outcome.planner))
        # The plan in force arrives as planned or with a delay: one that arrives before is compared
        # with it without solving for it.
        if not _arrives_before(followed, state):
            kept = rest(state)
            if kept is not None and not _arrives_before(followed, kept):
                followed = kept
        return None if followed is None else self._search_earlier(followed, situation, beside)

    def _search_earlier(
        self, plan: Following, situation: Situation, beside: SearchesBeside
    ) -> Following:
        """Begin a search for an earlier arrival, once a sample period; return the plan."""
        tuning, settings, now = plan.planner.tuning, self._settings, situation.time
        begins = now + max(beside.ahead, settings.control_period)
        idle = now > self._improved_at + settings.period - 0.5 * settings.control_period
        over = plan.fruitless >= tuning.fruitless_searches or plan.time_left(begins) < (
            tuning.fixed_time
        )
        if beside.purpose is None and idle and plan.work and not over:
            self._improved_at = now
            hold = plan.arrival.hold.delayed(plan.planned_at)
            start = later(situation, hold, begins, tuning.precise_step)
            start = dataclasses.replace(start, goal=plan.arrival.goal)
            known = plan.rest(begins)
            beside.begin(Purpose.EARLIER, plan.planner, start, plan.work, known=known)
        return plan

    def _found_beside(
        self, state: Searching, situation: Situation, beside: SearchesBeside, at_rest: bool,
        dead_band: float, deadline: float,
    ) -> Searching | Following:
        """Return the plan that a search beside the loop has found, or go on searching."""
        settings, outcome = self._settings, None
        if beside.purpose is Purpose.NEW:
            outcome = beside.take(situation.time, settings.control_period)
        if outcome is not None and self._is_for(outcome, situation.goal):
            at_once = outcome.from_rest and at_rest
            begins = situation.time if at_once else outcome.situation.time
            found = self._planned(outcome.result, state, outcome.planner, begins)
            if isinstance(found, Searching):
                return found
            self._grid.begin_again(begins)
            if at_once and outcome.begins_in(situation):
                return found
            followed = replan(found, situation, dead_band, deadline, settings)
            return Searching() if followed is None else followed
        if beside.purpose is not Purpose.NEW:
            start = situation
            if not at_rest:
                ramp = come_to_rest(situation, self._robot, self._tuning.rest_time, "").hold
                begins = situation.time + beside.ahead
                start = later(situation, ramp, begins, self._tuning.precise_step)
            beside.begin(
                Purpose.NEW, self._planner_for(situation), start, settings.planning_effort,
                self._growth(state, situation, at_rest), at_rest, state.strict,
            )
        return state

    def _is_for(self, outcome: WorkerSearch, goal: Vector) -> bool:
        """Return whether a search was for this goal, but for what momentum changes of it."""
        aimed = outcome.situation.goal
        turned = angle_error(goal, aimed) < self._tuning.largest_change_of_goal
        return turned and np.array_equal(aimed[POSITION], goal[POSITION])

    def _with_goal_of_plan(self, situation: Situation, beside: SearchesBeside) -> Situation:
        """Return the situation with the goal of the plan that is followed.

        To another goal a plan is searched for that begins a little later on the way; where that is
        not possible everything begins anew.
        """
        state, wanted = self._state, situation.goal
        goal = self._goal = wanted if self._goal is None else self._goal
        if np.array_equal(wanted, goal):
            if beside.purpose is Purpose.REDIRECT:
                beside.cancel()
            return situation
        outcome = None
        if beside.purpose is Purpose.REDIRECT:
            outcome = beside.take(situation.time, self._settings.control_period)
        simple = self._is_aimed_at(dataclasses.replace(situation, goal=wanted))
        if simple and isinstance(state, Searching) and beside.purpose is Purpose.NEW:
            # Goals that arrive faster than a search takes would otherwise prevent any plan.
            return dataclasses.replace(situation, goal=goal)
        arrival = None if outcome is None else outcome.result.arrival
        failed = outcome is not None and arrival is None
        if not isinstance(state, Following) or not simple or failed or not beside.available:
            self.reset()
            self._grid.begin(situation.time)
            self._goal = wanted
            return situation
        if outcome is not None and arrival is not None and not outcome.is_late:
            begins = outcome.situation.time
            for part in (self._goals, self._held_goal, self._rest_at_goal):
                part.reset()
            self._grid.begin_again(begins)
            goal = self._goal = outcome.situation.goal
            self._state = Following(arrival, begins, outcome.planner)
        elif beside.purpose is not Purpose.REDIRECT:
            hold = state.arrival.hold.delayed(state.planned_at)
            begins = situation.time + beside.ahead
            start = later(situation, hold, begins, self._tuning.precise_step)
            beside.begin(
                Purpose.REDIRECT, self._planner_for(situation),
                dataclasses.replace(start, goal=wanted), self._settings.planning_effort,
            )
        return dataclasses.replace(situation, goal=goal)

    def _is_aimed_at(self, situation: Situation) -> bool:
        """Return whether a new goal is aimed at as it is given."""
        goal = HeldGoal(self._robot.max_rotor_speed, self._tuning).goal(situation, None, False)
        aimed, _ = IntermediateGoals(self._tuning).aim(situation, 0.0)
        return goal is situation.goal and aimed is situation

    def _resting_band(self, dead_band: float, situation: Situation) -> float:
        """Return the error below which a sphere at rest stays: with momentum it is corrected."""
        small = self._tuning.is_small(situation)
        return dead_band if small else max(dead_band, self._tuning.held_dead_band)

    def _is_at_rest(self, situation: Situation) -> bool:
        """Return whether the rotors turn at the speeds at which the sphere rests."""
        in_force, tuning = situation.input_in_force, self._tuning
        turn, limit = situation.state[QUATERNION], self._robot.max_rotor_speed
        held = speeds_of_rest(situation.momentum, turn, limit)
        near = tuning.small_momentum + tuning.held_speed_factor * situation.uncertainty
        return bool(np.all(np.abs(in_force - held) < near))

    def _holdable(self, situation: Situation) -> Situation:
        """Return the situation with a goal at which the rotors hold the momentum.

        A plan that is being followed is kept and aims at the changed goal from then on, unless
        that is far from the last one.
        """
        state, end = self._state, None
        if isinstance(state, Following):
            end = state.momentum_at_arrival(situation)
        found_none = isinstance(state, Searching) and state.found_none
        goal = self._held_goal.goal(situation, end, isinstance(state, Holding), found_none)
        if isinstance(state, Following):
            turned = state.arrival.goal.copy()
            turned[QUATERNION] = nearer_sign(goal, turned)[QUATERNION]
            change = 0.0
            if not np.array_equal(turned, state.arrival.goal):
                change = angle_error(turned, state.arrival.goal)
            if change > self._tuning.largest_change_of_goal:
                self._state = Searching()
            elif change > 0.0:
                arrival = dataclasses.replace(state.arrival, goal=turned)
                self._state = dataclasses.replace(state, arrival=arrival)
        return situation if goal is situation.goal else dataclasses.replace(situation, goal=goal)

    def _aim(self, situation: Situation) -> Situation:
        """Return the situation with a goal near enough to plan for.

        Where that is another than before, the plan is dropped.
        """
        state = self._state
        left = state.time_left(situation.time) if isinstance(state, Following) else 0.0
        found_none = isinstance(state, Searching) and state.found_none
        aimed, is_new = self._goals.aim(situation, left, found_none)
        if is_new and isinstance(state, Searching | Following):
            self._state = Searching(strict=isinstance(state, Searching) and state.strict)
        return aimed

    def _as_plan(self, state: Following) -> Plan:
        arrival, start = state.arrival, state.planned_at
        late = arrival.error > self._tuning.arrival_error
        states = arrival.states
        hold = hold_momentum(
            arrival.hold.delayed(start), arrival.momentum, arrival.disturbance,
            arrival.goal[QUATERNION], self._robot.max_rotor_speed, self._tuning.rest_time,
        )
        rests = np.tile(states[-1], (hold.times.size - len(states), 1))
        return Plan(
            PlanStatus.BEST_SO_FAR if late else PlanStatus.SOLVED,
            hold,
            np.vstack((states, rests)),
            arrival=start + arrival.duration,
            cost=arrival.error**2,
            iterations=arrival.iterations,
            kkt_residual=arrival.kkt_residual,
            message=f"arrives in {arrival.duration:.2f} s, {arrival.error:.1e} off",
        )


def _arrives_before(plan: Following | None, other: Following) -> bool:
    """Return whether there is a plan that reaches the goal before another one does."""
    return plan is not None and plan.reaches and plan.arrives < other.arrives
