# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Search for an early arrival at a distant goal: that for a near one, and whole turns.

Whole turns of steady rolling lead from a near goal to the distant one, at the same orientation. So
the search aims at the near goal, whatever the distance. What it finds is extended by the turns and
solved again, as the direction to the near goal is slightly another one.
"""

import time
from dataclasses import replace

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import POSITION, Vector, flipped_sign
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Arrival
from sphere_nmpc.strategy.time_optimal.planner import ArrivalPlanner
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.steady_rolling import (
    SteadyRolling,
    with_turns,
    without_turns,
)

_FIRST_TURNS, _GROWTH = 8, 2
"""Whole turns that are added to a near arrival first, and factor by which they grow then."""

_PARTS = 4
"""Parts of a search at whose ends the best near arrival is extended."""
_LARGEST_SHORTENING = 0.04
"""Share of the time of manoeuvres by which an extended arrival is shortened at first."""


class DistantSearch:
    """Search from one situation to a goal near or far; used like an `ArrivalSearch`.

    Parameters
    ----------
    planner : ArrivalPlanner
        Searches for near goals and precise solutions.
    situation : Situation
        State at the start, and the goal.
    new_plan : bool
        As for `ArrivalPlanner.solve`.
    strict : bool, optional
        As for `ArrivalSearch`.
    start : Arrival, optional
        A known arrival at the goal, from which the search starts.
    """

    def __init__(
        self,
        planner: ArrivalPlanner,
        situation: Situation,
        new_plan: bool,
        strict: bool = False,
        start: Arrival | None = None,
    ) -> None:
        self._planner, self._situation, self._new_plan = planner, situation, new_plan
        self._rolling = SteadyRolling.of(situation.constants, planner.max_speed)
        self.best = start
        """The earliest arrival found so far."""
        self.work = 0
        """Solver iterations times intervals used so far."""
        self._turns = 0
        self._turn: Vector = np.zeros(2)
        """Displacement of a turn [m]."""
        near = situation
        if situation.drift.is_zero:
            near, start = self._near(start)
        self._search: ArrivalSearch = planner.search(near, new_plan, strict)
        self._found = start
        if start is not None:
            self._search.start_from(start)

    def improve(self, work: int, deadline: float = np.inf) -> Arrival | None:
        """Continue the search; see `ArrivalSearch.improve`."""
        # Not always the earliest arrival at the near goal becomes that at the distant one.
        parts = _PARTS if self._turns else 1
        for _ in range(parts):
            if time.perf_counter() < deadline:
                self._improve(-(-work // parts), deadline)
        return self.best

    def _improve(self, work: int, deadline: float) -> None:
        """Continue the near search and extend what it finds."""
        done = self._search.work
        found = self._search.improve(work, deadline)
        self.work += self._search.work - done
        if found is not None and found is not self._found:
            arrival = self._extended(found) if self._turns else found
            if arrival is not None and (
                self.best is None or arrival.duration < self.best.duration
            ):
                self.best = arrival
        self._found = found

    def _near(self, start: Arrival | None) -> tuple[Situation, Arrival | None]:
        """Return the situation with a near goal, and the arrival at it that `start` contains."""
        situation, rolling = self._situation, self._rolling
        if start is None:
            goal = situation.goal
            way = goal[POSITION] - situation.state[POSITION]
            beyond = float(np.linalg.norm(way)) - self._planner.tuning.near_distance
            self._turns = max(0, int(beyond / rolling.turn_length))
        else:
            goal, self._turns = start.goal, start.turns
            interval = int(np.argmax(np.diff(start.hold.times)))
            way = start.states[interval + 1, POSITION] - start.states[interval, POSITION]
        if not self._turns:
            return situation, start
        self._turn = rolling.turn_length / float(np.linalg.norm(way)) * way
        near = flipped_sign(goal) if self._turns % 2 else goal.copy()
        near[POSITION] = goal[POSITION] - self._turns * self._turn
        if start is not None:
            hold = without_turns(start.hold, interval, self._turns * rolling.turn_time)
            start = replace(start, hold=hold, goal=near)
        return replace(situation, goal=near), start

    def _extended(self, arrival: Arrival) -> Arrival | None:
        """Return an arrival at the goal from one at the near goal; None where there is none.

        Continuation: the nearer the goal, the more its direction differs from that of the distant
        one, so that the turns are added in steps.
        """
        added, extended = 0, arrival
        while added < self._turns:
            more = min(self._turns, max(_FIRST_TURNS, _GROWTH * added)) - added
            added += more
            guess = with_turns(
                extended.hold, more * self._rolling.turn_time, self._planner.max_speed
            )
            found = self._solved(self._goal_after(arrival.goal, added), guess)
            if found is None:
                return None
            extended = found
        return self._shortened(extended)

    def _shortened(self, arrival: Arrival) -> Arrival:
        """Shorten an arrival until it no longer reaches the goal."""
        tuning, planner = self._planner.tuning, self._planner
        share = _LARGEST_SHORTENING
        while share >= tuning.least_shortening:
            duration = tuning.stretched(arrival.duration, 1.0 - share)
            earlier = planner.solve(
                self._situation, arrival.goal, duration, arrival.hold, self._new_plan
            )
            self.work += earlier.work
            if earlier.error <= tuning.arrival_error:
                arrival = earlier
            else:
                share *= 0.5
        return arrival

    def _solved(self, goal: Vector, guess: FirstOrderHold) -> Arrival | None:
        """Return an arrival at `goal`, with a delay if need be; None where none has one."""
        tuning = self._planner.tuning
        for delay in tuning.delays + tuning.further_delays:
            duration = tuning.stretched(guess.end, delay)
            found = self._planner.solve(self._situation, goal, duration, guess, self._new_plan)
            self.work += found.work
            if found.error <= tuning.arrival_error:
                return found
        return None

    def _goal_after(self, near: Vector, turns: int) -> Vector:
        """Return the goal that is `turns` whole turns beyond the near one, with its sign."""
        goal = flipped_sign(near) if turns % 2 else near.copy()
        goal[POSITION] = self._situation.goal[POSITION] - (self._turns - turns) * self._turn
        return goal
