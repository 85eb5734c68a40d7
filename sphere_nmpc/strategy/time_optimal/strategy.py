# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time-optimal control with a shrinking horizon: plan once, arrive on time, then hold.

At a new goal the earliest arrival that a search finds is planned. At each later sample the rest
of the plan is solved again from the measured state, with one interval less; if it can no longer
reach the goal in time, the arrival is delayed a little. At the goal the rotors rest; small errors
are corrected by rolling, larger ones by a new plan. ``docs/strategy.md`` has the stability
argument.
"""

import dataclasses
import itertools
import time

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import state_error
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.time_optimal.grid import KnotGrid
from sphere_nmpc.strategy.time_optimal.holding import RestAtGoal, ramp_to_rest
from sphere_nmpc.strategy.time_optimal.intermediate_goals import IntermediateGoals
from sphere_nmpc.strategy.time_optimal.new_plan import PlanSearch
from sphere_nmpc.strategy.time_optimal.planner import ArrivalPlanner
from sphere_nmpc.strategy.time_optimal.replanning import replan
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.states import Following, Holding, Searching, State


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
        self,
        settings: ControllerSettings,
        robot: RobotParameters,
        tuning: TimeOptimalSettings | None = None,
    ) -> None:
        self._settings = settings
        self._robot = robot
        self._tuning = TimeOptimalSettings() if tuning is None else tuning
        self._goals = IntermediateGoals(self._tuning)
        self._rest_at_goal = RestAtGoal(settings, robot, self._tuning)
        self.reset()

    def change(self, settings: ControllerSettings) -> None:
        """Use another planning effort and other weights; plan and started search are kept."""
        self._settings = settings
        self._rest_at_goal.change(settings)

    def reset(self) -> None:
        """Forget plans and searches; the strategy then behaves like a new one."""
        self._state: State = Searching()
        period, tuning = self._settings.period, self._tuning
        self._grid, seeds = KnotGrid(period, tuning), itertools.count(1)
        acceleration = tuning.slip_acceleration * self._robot.max_rotor_acceleration
        slippery = dataclasses.replace(self._robot, max_rotor_acceleration=acceleration)
        self._plan_search = PlanSearch(
            ArrivalPlanner(self._robot, period, self._grid, seeds, tuning),
            ArrivalPlanner(slippery, period, self._grid, seeds, tuning),
        )
        self._goals.reset()
        self._rest_at_goal.reset()

    def plan(self, situation: Situation) -> Plan:
        """Follow the plan, search for a new one, or rest at the goal."""
        began = time.perf_counter()
        self._grid.begin(situation.time)
        situation = self._aim(situation)
        self._state = self._next(self._state, situation, began + situation.time_budget)
        if isinstance(self._state, Holding):
            return self._rest_at_goal.plan(situation)
        if isinstance(self._state, Following):
            plan = self._as_plan(self._state)
        else:
            acceleration = self._robot.max_rotor_acceleration
            message = "no arrival found yet"
            plan = ramp_to_rest(situation, acceleration, PlanStatus.RAMP_TO_REST, message)
        return dataclasses.replace(plan, solve_time=time.perf_counter() - began)

    def _next(self, state: State, situation: Situation, deadline: float) -> State:
        """Return the state that follows from `state` and the present situation.

        Following -> Following while the rest of the plan reaches the goal. A plan that has ended,
        or can no longer reach it, ends in Holding if the sphere rests within the dead band, else
        in a search. Holding -> Searching when the error leaves the dead band. Searching ->
        Following once there is a plan, -> Holding if the sphere rests within the dead band.
        """
        tuning, settings = self._tuning, self._settings
        dead_band = tuning.dead_band(situation.noise, situation.uncertainty)
        if isinstance(state, Following):
            followed = replan(state, situation, dead_band, deadline, settings)
            if followed is not None:
                return followed
            state = Searching()
        error = state_error(situation.state, situation.goal)
        at_rest = bool(np.all(np.abs(situation.input_in_force) < tuning.rest_speed))
        if isinstance(state, Holding):
            if error < max(dead_band, state.leaving_error):
                return state
            state = Searching()
        elif at_rest and error < dead_band:
            return Holding(tuning.leaving_band(situation.uncertainty))
        self._rest_at_goal.reset()
        return self._plan_search.search(state, situation, at_rest, deadline, settings)

    def _aim(self, situation: Situation) -> Situation:
        """Return the situation with a goal near enough to plan for.

        Where that is another than before, the plan is extended to it if possible, else dropped.
        """
        state, now = self._state, situation.time
        left = state.time_left(now) if isinstance(state, Following) else 0.0
        aimed, is_new, is_moved_on = self._goals.aim(situation, left)
        if is_new and isinstance(state, Searching):
            self._state = Searching(strict=state.strict)
        elif is_new and isinstance(state, Following):
            self._state = Searching()
            if is_moved_on:
                arrival = self._goals.extended(state.arrival, state.rest(now), aimed)
                if arrival is not None:
                    self._state = dataclasses.replace(state, arrival=arrival, planned_at=now)
        return aimed

    def _as_plan(self, state: Following) -> Plan:
        arrival, start = state.arrival, state.planned_at
        late = arrival.error > self._tuning.arrival_error
        return Plan(
            PlanStatus.BEST_SO_FAR if late else PlanStatus.SOLVED,
            arrival.hold.delayed(start),
            arrival.states,
            arrival=start + arrival.duration,
            cost=arrival.error**2,
            iterations=arrival.iterations,
            kkt_residual=arrival.kkt_residual,
            message=f"arrives in {arrival.duration:.2f} s, {arrival.error:.1e} off",
        )
