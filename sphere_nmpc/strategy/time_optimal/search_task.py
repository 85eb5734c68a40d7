# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Search for a plan with all that it depends on, so that it can be done in any process."""

import itertools
import time
from dataclasses import dataclass, replace

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import nearer_sign
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Arrival
from sphere_nmpc.strategy.time_optimal.distant_search import DistantSearch
from sphere_nmpc.strategy.time_optimal.grid import KnotGrid
from sphere_nmpc.strategy.time_optimal.planner import ArrivalPlanner
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.worker.contract import Store


@dataclass(frozen=True, eq=False)
class SearchTask:
    """Search for a plan that begins in a given situation, called in a worker.

    Attributes
    ----------
    robot : RobotParameters
        Limits of the drives.
    period : float
        Sample period [s].
    tuning : TimeOptimalSettings
        Tuning of the search.
    situation : Situation
        Situation in which the plan begins.
    origin : float
        Control time of a knot of the plan [s].
    seed : int
        Seed of the initial guesses.
    effort : int
        Planning effort.
    longest : float
        Wall time at which the search stops [s].
    strict : bool
        As for `ArrivalSearch`.
    known : FirstOrderHold or None
        Rest of the plan that is being followed, from time 0 on: an earlier arrival is searched
        for. None for a new plan.
    """

    robot: RobotParameters
    period: float
    tuning: TimeOptimalSettings
    situation: Situation
    origin: float
    seed: int
    effort: int
    longest: float
    strict: bool = False
    known: FirstOrderHold | None = None

    def __call__(self, store: Store | None = None) -> "SearchResult":
        """Search, and solve what is found precisely."""
        grid = KnotGrid(self.period, self.tuning)
        grid.begin(self.origin)
        seeds = itertools.count(self.seed)
        planner = ArrivalPlanner(self.robot, self.period, grid, seeds, self.tuning)
        end = time.perf_counter() + self.longest
        if self.known is None:
            return self._new_plan(planner, end)
        return self._earlier(planner, self.known, end)

    def _new_plan(self, planner: ArrivalPlanner, end: float) -> "SearchResult":
        situation = self.situation
        goal = nearer_sign(situation.goal, situation.state)
        search = DistantSearch(
            planner, replace(situation, goal=goal), new_plan=True, strict=self.strict
        )
        found = search.improve(self.effort, end)
        if found is None:
            return SearchResult(found_none=True)
        return SearchResult(_precise(planner, situation, found))

    def _earlier(
        self, planner: ArrivalPlanner, known: FirstOrderHold, end: float
    ) -> "SearchResult":
        situation, tuning = self.situation, planner.tuning
        start = planner.solve(situation, situation.goal, known.end, known, new_plan=False)
        if start.error > tuning.kept_error(start.turns):
            return SearchResult()
        search = DistantSearch(planner, situation, new_plan=False, start=start)
        found = search.improve(self.effort, end)
        if found is None or found is start:
            return SearchResult()
        precise = planner.solve(situation, found.goal, found.duration, found.hold, new_plan=False)
        return SearchResult(precise if precise.error <= tuning.arrival_error else None)


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Result of a `SearchTask`.

    Attributes
    ----------
    arrival : Arrival or None
        The plan, from time 0 on; None where there is none, or none that is precise.
    found_none : bool
        Whether the search has found no arrival at all.
    """

    arrival: Arrival | None = None
    found_none: bool = False


def search_task(
    planner: ArrivalPlanner,
    situation: Situation,
    origin: float,
    effort: int,
    longest: float,
    strict: bool = False,
    known: FirstOrderHold | None = None,
) -> SearchTask:
    """Return the search that a planner would do, with its next seed; see `SearchTask`."""
    return SearchTask(
        planner.robot, planner.period, planner.general_tuning, situation, origin,
        planner.next_seed(), effort, longest, strict, known,
    )


def _precise(planner: ArrivalPlanner, situation: Situation, found: Arrival) -> Arrival | None:
    """Return what a search has found, solved precisely, with a delay if need be.

    None if it does not reach the goal with any delay that is tried.
    """
    tuning = planner.tuning
    with_momentum = not situation.drift.is_zero
    accepted = tuning.rolling_back_error if with_momentum else tuning.arrival_error
    for delay in tuning.delays + tuning.further_delays:
        duration = tuning.stretched(found.duration, delay)
        arrival = planner.solve(situation, found.goal, duration, found.hold, new_plan=True)
        if arrival.error <= accepted:
            return arrival
    return None
