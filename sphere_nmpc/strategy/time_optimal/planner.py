# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Searches and precise solutions on a common grid of knots, for goals near or far.

Whole turns of steady rolling lead from a near goal to the distant one, at the same orientation. So
the search aims at the near goal, whatever the distance. What it finds is extended by the turns and
solved again, as the direction to the near goal is slightly another one.
"""

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, Vector, flipped_sign
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Accuracy, Arrival, ArrivalSolver
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.steady_rolling import (
    SteadyRolling,
    with_turns,
    without_turns,
)

_SAME_TIME = 1e-4
"""Time to a knot [s] below which it counts as passed."""
_FIRST_TURNS, _GROWTH = 8, 2
"""Whole turns that are added to a near arrival first, and factor by which they grow then."""
_PARTS = 4
"""Parts of a search at whose ends the best near arrival is extended."""
_LARGEST_SHORTENING = 0.04
"""Share of the time of manoeuvres by which an extended arrival is shortened at first."""


class KnotGrid:
    """Sampling instants at which the knots of all plans lie, until a reset.

    Parameters
    ----------
    period : float
        Sample period: spacing of the knots [s].
    settings : TimeOptimalSettings
        Shortest interval.
    """

    def __init__(self, period: float, settings: TimeOptimalSettings) -> None:
        self._period = period
        self._shortest = settings.shortest_interval * period
        self._origin: float | None = None

    def begin(self, now: float) -> None:
        """Begin the grid at `now` [s] unless it has begun."""
        if self._origin is None:
            self._origin = now

    def begin_again(self, now: float) -> None:
        """Begin the grid at `now` [s]."""
        self._origin = now

    def origin(self, now: float) -> float:
        """Return the control time of one of the knots [s]: `now` if the grid has not begun."""
        return now if self._origin is None else self._origin

    def to_first_knot(self, now: float, new_plan: bool) -> float:
        """Return the time from `now` [s] to the first knot after it [s], positive.

        A new plan leaves out a knot that is too near. A plan that is being followed changes its
        slope there, however near, and would not be feasible without it.
        """
        left = self._period - float(np.mod(now - self.origin(now), self._period))
        shortest = self._shortest if new_plan else _SAME_TIME
        return left + self._period if left < shortest else left


class ArrivalPlanner:
    """Searches and precise solutions for one set of drive limits.

    Parameters
    ----------
    robot : RobotParameters
        Limits of the drives.
    period : float
        Sample period: spacing of the knots [s].
    grid : KnotGrid
        Times of the knots.
    seeds : iterator of int
        Seeds of the searches, shared with other planners.
    tuning : TimeOptimalSettings
        Tuning of searches and solves.
    """

    def __init__(
        self, robot: RobotParameters, period: float, grid: KnotGrid, seeds: Iterator[int],
        tuning: TimeOptimalSettings,
    ) -> None:
        self.general_tuning = tuning
        """Tuning of searches and solves for any robot."""
        tuning = self.tuning = tuning.of(robot)
        """The same for this robot."""
        self.robot = robot
        """Limits of the drives."""
        self.period = period
        """Sample period [s]."""
        self.grid = grid
        """Times of the knots."""
        self.seeds = seeds
        """Seeds of the searches."""
        accuracy = Accuracy(
            tuning.precise_iterations, tuning.precise_step, tuning.precise_error,
            tuning.precise_rest_speed,
        )
        self._solver = ArrivalSolver(robot, period, accuracy, tuning)

    def search(self, situation: Situation, new_plan: bool, strict: bool = False) -> ArrivalSearch:
        """Return a new search; `new_plan` as for `solve`, `strict` as for `ArrivalSearch`."""
        first = self.grid.to_first_knot(situation.time, new_plan)
        return ArrivalSearch(
            self.robot, self.period, situation, first, next(self.seeds), self.tuning, strict
        )

    def solve(
        self, situation: Situation, goal: Vector, duration: float, guess: FirstOrderHold,
        new_plan: bool,
    ) -> Arrival:
        """Solve precisely for rotor speeds that end at `goal` after `duration` [s].

        As `ArrivalSolver.solve`, with the first knot on the grid. `new_plan` is False where
        `guess` is the rest of the plan that is being followed.
        """
        first = self.grid.to_first_knot(situation.time, new_plan)
        return self._solver.solve(situation, goal, duration, guess, first)

    def solve_delayed(
        self, situation: Situation, goal: Vector, guess: FirstOrderHold, new_plan: bool
    ) -> Arrival | None:
        """Solve for the duration of the guess, or with a delay if need be.

        None if no delay that is tried makes it reach the goal.
        """
        tuning = self.tuning
        for delay in tuning.delays + tuning.further_delays:
            duration = tuning.stretched(guess.end, delay)
            found = self.solve(situation, goal, duration, guess, new_plan)
            if found.error <= tuning.new_plan_error:
                return found
        return None


class DistantSearch:
    """Search from one situation to a goal near or far; used like an `ArrivalSearch`.

    Parameters
    ----------
    planner : ArrivalPlanner
        Searches for near goals and precise solutions.
    situation, new_plan, strict
        As for `ArrivalPlanner.search`.
    start : Arrival, optional
        A known arrival at the goal, from which the search starts.
    """

    def __init__(
        self, planner: ArrivalPlanner, situation: Situation, new_plan: bool,
        strict: bool = False, start: Arrival | None = None,
    ) -> None:
        self._planner, self._situation, self._new_plan = planner, situation, new_plan
        self._rolling = SteadyRolling.of(situation.constants, planner.robot.max_rotor_speed)
        self.best = start
        """The earliest arrival found so far."""
        self._turns = 0
        self._turn: Vector = np.zeros(2)
        """Displacement of a turn [m]."""
        near = situation
        if planner.tuning.is_small(situation):
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
        found = self._search.improve(work, deadline)
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
                extended.hold, more * self._rolling.turn_time, self._planner.robot.max_rotor_speed
            )
            found = self._planner.solve_delayed(
                self._situation, self._goal_after(arrival.goal, added), guess, self._new_plan
            )
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
            if earlier.error <= tuning.arrival_error:
                arrival = earlier
            else:
                share *= 0.5
        return arrival

    def _goal_after(self, near: Vector, turns: int) -> Vector:
        """Return the goal that is `turns` whole turns beyond the near one, with its sign."""
        goal = flipped_sign(near) if turns % 2 else near.copy()
        goal[POSITION] = self._situation.goal[POSITION] - (self._turns - turns) * self._turn
        return goal
