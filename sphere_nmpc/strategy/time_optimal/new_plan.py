# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Search for a new plan, over several samples where one is too short."""

import dataclasses

from sphere_nmpc.model.state import nearer_sign
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.distant_search import DistantSearch
from sphere_nmpc.strategy.time_optimal.planner import ArrivalPlanner
from sphere_nmpc.strategy.time_optimal.search_task import precise_arrival
from sphere_nmpc.strategy.time_optimal.states import Following, Searching, StartedSearch


class PlanSearch:
    """Search for a new plan from the present state.

    Parameters
    ----------
    full, reduced : ArrivalPlanner
        Planners with the full and with a reduced limit of acceleration, for slippery floors. Their
        common grid of knots begins again with a plan that a search found at a later sample.
    """

    def __init__(self, full: ArrivalPlanner, reduced: ArrivalPlanner) -> None:
        self._full = full
        self._reduced = reduced
        self._tuning = full.tuning

    def search(
        self,
        state: Searching,
        situation: Situation,
        at_rest: bool,
        deadline: float,
        settings: ControllerSettings,
    ) -> Searching | Following:
        """Begin a search or continue the one that was started, and solve its result precisely.

        At a high control rate no sample is long enough: a search from rest, which is as good a
        little later, is then continued at the next ones. While the robot moves, the situation
        changes, and each sample begins a new search.

        Parameters
        ----------
        state : Searching
            Search to be continued, if any.
        situation : Situation
            With a goal that is near enough to plan for.
        at_rest : bool
            Whether the rotors are at rest.
        deadline : float
            Steady clock reading at which to stop [s].
        settings : ControllerSettings
            Planning effort, sample period, control period.

        Returns
        -------
        Searching or Following
            Following once a plan is found that reaches the goal.
        """
        started = state.started
        if started is None or not at_rest:
            started = self._begin(situation, state.strict)
        search, planner, now = started.search, started.planner, situation.time
        effort = settings.planning_effort
        found = search.improve(effort - search.work, deadline)
        unspent = max(0, effort - search.work)
        waited = now - started.begun_at
        longest = self._tuning.search_share * settings.period
        if at_rest and unspent and waited + settings.control_period < longest:
            return Searching(started, state.strict)
        if found is None:
            return Searching(strict=state.strict, found_none=True)
        if waited > 0.0:
            planner.grid.begin_again(now)
        arrival = precise_arrival(planner, situation, found)
        if arrival is None:
            return Searching(strict=True)
        return Following(arrival, now, planner, unspent)

    def planner(self, situation: Situation) -> ArrivalPlanner:
        """Return the planner with the limit of acceleration that the floor allows."""
        slippery = situation.noise > self._tuning.slip_noise
        return self._reduced if slippery else self._full

    def _begin(self, situation: Situation, strict: bool) -> StartedSearch:
        planner = self.planner(situation)
        goal = nearer_sign(situation.goal, situation.state)
        search = DistantSearch(
            planner, dataclasses.replace(situation, goal=goal), new_plan=True, strict=strict
        )
        return StartedSearch(search, planner, situation.time)
