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

import time
from dataclasses import replace
from functools import partial

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.at_rest import SATURATED, AtRest
from sphere_nmpc.strategy.clearance import stop_before_contact
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.in_force import InForce
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.rest import come_to_rest, stop
from sphere_nmpc.strategy.time_optimal.following import held_at_its_end, momentum_at_arrival
from sphere_nmpc.strategy.time_optimal.machine import (
    Holding,
    Machine,
    Saturated,
    Searching,
    State,
)
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.worker.contract import Worker

_REPORTED_SEARCHES = 8
"""Searches without a plan from which on that is reported."""


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
        self._robot = robot
        self._tuning = TimeOptimalSettings() if tuning is None else tuning
        self._at_rest = AtRest(settings, robot, self._tuning)
        self._machine = Machine(settings, robot, self._tuning)
        self._aimed: tuple[object, int] | None = None

    def search_beside(self, worker: Worker) -> None:
        """Search by a worker from now on, and follow the plan meanwhile.

        The plan in force is followed until there is one to a new goal.
        """
        self._machine.search.work_by(worker)

    def is_due(self, now: float) -> bool:
        """Return whether a search has ended whose plan begins at `now` [s] or before."""
        return self._machine.search.is_due(now)

    @property
    def searches(self) -> bool:
        """Whether a plan is being searched for beside the loop, other than an earlier arrival."""
        return self._machine.search.is_awaited

    def change(self, settings: ControllerSettings) -> None:
        """Use another planning effort and other weights; plan and started search are kept."""
        self._machine.search.change(settings)
        self._at_rest.change(settings)

    def reset(self) -> None:
        """Forget plans and searches; the strategy then behaves like a new one."""
        self._machine.reset()
        self._aimed = None
        self._at_rest.reset()

    def plan(self, situation: Situation) -> Plan:
        """Follow the plan, search for a new one, or rest at the goal."""
        began = time.perf_counter()
        machine, at_rest = self._machine, self._at_rest
        aimed = situation.course.origin, situation.leg
        if aimed != self._aimed:
            at_rest.reset()
            machine.forget_goal()
        self._aimed = aimed
        machine.use_attained(situation.plant.acceleration)
        before, end = machine.enter_leg(situation), None
        if isinstance(before, InForce):
            situation = situation.nearest_to(before.plan.leg.goal.pose)
            end = partial(momentum_at_arrival, before)
        else:
            situation = situation.nearest_to(situation.state)
        rests = isinstance(before, Holding)
        found_none = isinstance(before, Searching) and machine.search.failed > 0
        situation = situation.aimed_at(
            situation.aim(at_rest.goal(situation, end, rests, found_none))
        )
        state = machine.advance(situation, began + situation.time_budget)
        if isinstance(state, Holding) and not rests:
            at_rest.forget_corrections()
        plan = self._plan_of(state, situation)
        made = plan.made
        if not isinstance(state, Holding):
            made = replace(made, solve_time=time.perf_counter() - began)
        if at_rest.limitation and plan.limitation is None:
            plan = plan.giving_up(at_rest.limitation)
        return replace(
            plan, until=machine.until(situation), tolerance=self._tuning.arrival_error, made=made
        )

    def _plan_of(self, state: State, situation: Situation) -> Plan:
        """Return the plan of a state."""
        robot, search = self._robot, self._machine.search
        if isinstance(state, Holding):
            return self._at_rest.plan(situation)
        if isinstance(state, InForce):
            own, after = state.plan, state.after
            rest = held_at_its_end((after or state).plan, situation, robot.max_rotor_speed)
            return rest if after is None else own.spliced(rest.hold, rest.states)
        if isinstance(state, Saturated):
            plan = come_to_rest(situation, robot, "saturated", PlanStatus.SATURATED)
            return plan.giving_up(SATURATED)
        if search.no_way:
            lasts = situation.floor.lasting is situation.floor
            kind = Kind.NO_WAY if lasts else Kind.GIVEN_UP
            return stop(situation, robot, "no way to the goal").giving_up(search.no_way, kind)
        plan = stop(situation, robot, "no arrival found yet")
        given_up = stop_before_contact(situation, plan.hold)
        if not given_up and search.failed >= _REPORTED_SEARCHES:
            given_up = "the goal for now: no motion to it was found from here"
        return plan.giving_up(given_up)
