# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Searches for plans: in line, or by a worker while the control loop follows a plan or rests.

A search has all that it depends on, so that it can be done in any process. What a worker finds is
a plan that begins a little later, in the state predicted for that time: until then the loop goes
on as before. From rest it may begin at any time.
"""

import itertools
import time
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, nearer_sign
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Arrival
from sphere_nmpc.strategy.time_optimal.planner import ArrivalPlanner, DistantSearch, KnotGrid
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.worker.contract import Reply, Store, Worker

_GROWTH = 2.0
"""Factor on the time ahead after a search that was not complete in time."""
_SAME_TIME = 1e-6
"""Rounding of control times [s]."""
_LEAST_TICK = 0.02
"""Delay [s] by which a plan may begin later at the highest control rates, too."""


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
        return SearchResult(
            planner.solve_delayed(situation, found.goal, found.hold, new_plan=True)
        )

    def _earlier(
        self, planner: ArrivalPlanner, known: FirstOrderHold, end: float
    ) -> "SearchResult":
        situation, tuning = self.situation, planner.tuning
        start = planner.solve(situation, situation.goal, known.end, known, new_plan=False)
        if start.error > tuning.kept_error(start.turns):
            return SearchResult()
        return earlier_arrival(planner, situation, start, self.effort, end)


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Result of a search.

    Attributes
    ----------
    arrival : Arrival or None
        The plan, from time 0 on; None where there is none, or none that is precise.
    found_none : bool
        Whether the search has found no arrival at all, or none but the one that was known.
    """

    arrival: Arrival | None = None
    found_none: bool = False


def search_task(
    planner: ArrivalPlanner, situation: Situation, origin: float, effort: int, longest: float,
    strict: bool = False, known: FirstOrderHold | None = None,
) -> SearchTask:
    """Return the search that a planner would do, with its next seed; see `SearchTask`."""
    return SearchTask(
        planner.robot, planner.period, planner.general_tuning, situation, origin,
        next(planner.seeds), effort, longest, strict, known,
    )


def earlier_arrival(
    planner: ArrivalPlanner, situation: Situation, start: Arrival, effort: int, deadline: float
) -> SearchResult:
    """Search for an arrival before `start`, that of the rest of the plan which is followed."""
    search = DistantSearch(planner, situation, new_plan=False, start=start)
    found = search.improve(effort, deadline)
    if found is None or found is start:
        return SearchResult(found_none=True)
    precise = planner.solve(situation, found.goal, found.duration, found.hold, new_plan=False)
    return SearchResult(precise if precise.error <= planner.tuning.arrival_error else None)


class Purpose(Enum):
    """What a search is for."""

    NEW = "a plan where there is none"
    EARLIER = "an earlier arrival than that of the plan"
    REDIRECT = "a plan to another goal, while one is followed"


@dataclass(frozen=True, eq=False)
class WorkerSearch:
    """A search by a worker.

    Attributes
    ----------
    purpose : Purpose
        What it is for.
    task : SearchTask
        With the situation in which the plan begins.
    planner : ArrivalPlanner
        Planner with the limits of the search.
    from_rest : bool
        Whether the plan may begin at any time.
    reply : Reply
        Result, once there is one.
    result : SearchResult
        What a complete search has found.
    is_late : bool
        Whether the plan should have begun before.
    """

    purpose: Purpose
    task: SearchTask
    planner: ArrivalPlanner
    from_rest: bool
    reply: Reply[SearchResult]
    result: SearchResult = SearchResult()
    is_late: bool = False

    @property
    def situation(self) -> Situation:
        """Situation in which the plan begins."""
        return self.task.situation

    def begins_in(self, situation: Situation) -> bool:
        """Return whether the plan begins in this situation, whatever the time.

        A sphere at rest may have been moved since, and what is estimated of it may have changed.
        """
        pairs = zip(_where(self.situation), _where(situation), strict=True)
        return all(np.array_equal(planned, now) for planned, now in pairs)


def _where(situation: Situation) -> tuple[Vector, ...]:
    torques = situation.disturbance.as_array()
    return situation.state, situation.input_in_force, situation.constants.as_array(), torques


class SearchesBeside:
    """Searches by a worker, one at a time.

    Parameters
    ----------
    worker : Worker
        Does the searches.
    tuning : TimeOptimalSettings
        How far ahead a plan begins, and how long a search may take.
    """

    def __init__(self, worker: Worker, tuning: TimeOptimalSettings) -> None:
        self._worker = worker
        self._tuning = tuning
        self._under_way: WorkerSearch | None = None
        self.ahead = tuning.search_ahead
        """Time from the request of a search to the start of its plan [s, control time]."""

    @property
    def available(self) -> bool:
        """Whether the worker takes tasks; otherwise it has to be searched in line."""
        return self._worker.available

    @property
    def purpose(self) -> Purpose | None:
        """What the search under way is for; None without one."""
        return None if self._under_way is None else self._under_way.purpose

    def cancel(self) -> None:
        """Forget the search under way."""
        self._under_way = None

    def begin(
        self, purpose: Purpose, planner: ArrivalPlanner, situation: Situation, effort: int,
        growth: float = 1.0, from_rest: bool = False, strict: bool = False,
        known: FirstOrderHold | None = None,
    ) -> None:
        """Begin a search for a plan from `situation`; one under way is forgotten.

        Parameters as for `SearchTask`, effort and longest time times `growth`; `from_rest` as for
        `WorkerSearch`.
        """
        origin = situation.time if known is None else planner.grid.origin(situation.time)
        longest = growth * self._tuning.longest_search
        task = search_task(
            planner, situation, origin, round(growth * effort), longest, strict, known
        )
        reply = self._worker.submit(task)
        self._under_way = None
        if reply.pending or reply.ready:
            self._under_way = WorkerSearch(purpose, task, planner, from_rest, reply)

    def is_due(self, now: float) -> bool:
        """Return whether `take` returns a result at `now` [s]."""
        search = self._under_way
        if search is None:
            return False
        self._worker.poll()
        if search.reply.error:
            self._under_way = None
        due = search.from_rest or now >= search.situation.time - _SAME_TIME
        return search.reply.ready and due

    def take(self, now: float, tick: float) -> WorkerSearch | None:
        """Return the search under way once it is complete and its plan begins at `now` [s].

        A plan that should have begun within the last `tick`, between two samples [s], is not late.
        """
        search = self._under_way
        if search is None or not self.is_due(now):
            return None
        self._under_way, result = None, search.reply.result
        if result is None:
            return None
        late = now - search.situation.time
        is_late = not search.from_rest and late > max(tick, _LEAST_TICK) + _SAME_TIME
        if is_late:
            self.ahead = min(_GROWTH * self.ahead, self._tuning.search_farthest_ahead)
        return replace(search, result=result, is_late=is_late)


def later(situation: Situation, hold: FirstOrderHold, time: float, max_step: float) -> Situation:
    """Return the situation at control time `time` [s] if the rotors follow `hold` until then.

    It is predicted in integration steps of up to `max_step` [s].
    """
    now = situation.time
    if time <= now:
        return situation
    knots = hold.times[(hold.times > now) & (hold.times < time)]
    times = np.concatenate(([now], knots, [time]))
    speeds = np.array([hold.at(float(t)) for t in times])
    state = roll_out(
        situation.state, speeds, np.diff(times), situation.constants.as_array(), max_step,
        situation.disturbance,
    )[-1]
    return replace(situation, time=time, state=state, input_in_force=speeds[-1])
