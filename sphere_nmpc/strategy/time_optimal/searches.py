# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Searches for plans, in line or by a worker while the control loop follows a plan or rests.

A search has all that it depends on, so that it can be done in any process. What it finds is a plan
that begins in the state predicted for a time somewhat ahead: until then the loop goes on as
before. In line nothing is ahead.
"""

import time
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Arrival, ArrivalSolver
from sphere_nmpc.strategy.time_optimal.guide import (
    detour_to_goal,
    leads_on,
    line_on,
    lines_to_goal,
    local_goal,
    time_to_go,
    with_lines,
)
from sphere_nmpc.strategy.time_optimal.knots import Grid
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.worker.contract import Reply, Store, Worker

_GROWTH = 2.0
"""Factor on the time ahead after a search that was not complete in time."""
_SAME_TIME = 1e-6
"""Rounding of control times [s]."""
_LEAST_TICK = 0.02
"""Delay [s] by which a plan may begin later at the highest control rates, too."""


@lru_cache(maxsize=8)
def solver_for(robot: RobotParameters, tuning: TimeOptimalSettings) -> ArrivalSolver:
    """Return the solver for a robot, whose limits may be less than those of its drives."""
    return ArrivalSolver(robot, Grid.of(robot, tuning.spacing), tuning)


@dataclass(frozen=True)
class NoWay:
    """Result of a search for a goal to which no way leads."""

    reason: str


@dataclass(frozen=True, eq=False)
class SearchTask:
    """Search for a plan that begins in a given situation, called in a worker or in line.

    Attributes
    ----------
    robot : RobotParameters
        Limits of the drives.
    tuning : TimeOptimalSettings
        Tuning of the search.
    situation : Situation
        Situation in which the plan begins.
    seed : int
        Seed of the initial guesses.
    effort : int
        Planning effort of a new plan.
    longest : float
        Wall time at which the search stops [s].
    from_rest : bool
        Whether the sphere rests until the plan begins, which may then be at any time.
    known : FirstOrderHold or None
        Rest of the plan that is being followed to the same goal, from time 0 on: an earlier
        arrival is searched for. None for a new plan.
    fruitless : int
        Searches before it that have found nothing; a goal on the way around obstacles is then
        nearer.
    rested : ndarray of shape (2,), or None
        Where the sphere has last rested [m], from which a part of the way has to lead on; None
        where it is now.
    """

    robot: RobotParameters
    tuning: TimeOptimalSettings
    situation: Situation
    seed: int
    effort: int
    longest: float
    from_rest: bool = False
    known: FirstOrderHold | None = None
    fruitless: int = 0
    rested: Vector | None = None

    def __call__(self, store: Store | None = None) -> Arrival | NoWay | None:
        """Return the earliest arrival that is found, but for the one that is known."""
        solver, end = solver_for(self.robot, self.tuning), time.perf_counter() + self.longest
        if self.known is not None:
            return self._earlier(solver, self.known, end)
        guidance = local_goal(self.situation, solver, self.fruitless)
        if guidance.reason:
            return NoWay(guidance.reason)
        for aim in guidance.aims:
            search = ArrivalSearch(solver, aim.situation, self.seed, detour=aim.detour)
            found = search.improve(int(aim.share * self.effort), end)
            if found is not None and aim.is_final:
                return found
            if found is not None and leads_on(self.situation, self._rested, _end_of(found)):
                return self._part(found)
        if not guidance.by_lines or not self.tuning.is_small(self.situation):
            return None  # lines are those of a sphere without momentum
        found = self._by_lines(solver, end) if guidance.sees_goal else None
        if found is None and self.from_rest:
            line = line_on(self.situation, solver, self._rested)
            return None if line is None else self._part(line)
        return found

    @property
    def _rested(self) -> Vector:
        return self.situation.state[POSITION] if self.rested is None else self.rested

    def _part(self, arrival: Arrival) -> Arrival:
        """Return an arrival on the way with the time from there to the final goal."""
        limit = self.robot.max_rotor_speed
        return replace(arrival, to_go=time_to_go(self.situation, _end_of(arrival), limit))

    def _earlier(
        self, solver: ArrivalSolver, known: FirstOrderHold, end: float
    ) -> Arrival | None:
        """Return an earlier arrival than that of the plan that is known; None without one."""
        situation = self.situation
        start = solver.solve(situation, situation.goal, known, budget=self.longest, kept=True)
        if start.error > self.tuning.arrival_error:
            return None
        search = ArrivalSearch(solver, situation, self.seed, start, detour_to_goal(situation))
        found = search.improve_once(end)
        return None if found is start else found

    def _by_lines(self, solver: ArrivalSolver, end: float) -> Arrival | None:
        """Return an arrival at the goal that ends with straight lines to it."""
        lines = lines_to_goal(self.situation, solver)
        if lines is None:
            return None
        aim = replace(self.situation, goal=lines[0], orientation=Orientation.FULL)
        found = ArrivalSearch(solver, aim, self.seed).improve(self.effort, end)
        return None if found is None else with_lines(self.situation, found, lines[1])


def _end_of(arrival: Arrival) -> Vector:
    """Return the place where an arrival ends, shape (2,) [m]."""
    return arrival.states[-1, POSITION]


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of a search: its task and the plan, from time 0 on, or None where there is none.

    `reason` says why there is none wherever one searches; empty where that is not so.
    """

    task: SearchTask
    arrival: Arrival | None
    reason: str = ""


class Searches:
    """Searches by a worker, one at a time.

    Parameters
    ----------
    worker : Worker
        Does the searches.
    ahead : float
        Time from the request of a search to the start of its plan [s, control time], at first.
    farthest : float
        The same at most, after searches that took longer.
    """

    def __init__(self, worker: Worker, ahead: float = 0.0, farthest: float = 0.0) -> None:
        self._worker, self._farthest = worker, farthest
        self._task: SearchTask | None = None
        self._reply: Reply[Arrival | NoWay | None] = Reply()
        self.ahead = ahead
        """Time from the request of a search to the start of its plan [s, control time]."""

    @property
    def available(self) -> bool:
        """Whether the worker takes tasks."""
        return self._worker.available

    @property
    def task(self) -> SearchTask | None:
        """The search under way; None without one."""
        return self._task

    def cancel(self) -> None:
        """Forget the search under way."""
        self._task = None

    def begin(self, task: SearchTask) -> None:
        """Begin a search; one under way is forgotten."""
        self._reply = self._worker.submit(task)
        self._task = task if self._reply.pending or self._reply.ready else None

    def is_due(self, now: float) -> bool:
        """Return whether `take` returns an outcome at `now` [s]."""
        task = self._task
        if task is None:
            return False
        self._worker.poll()
        if self._reply.error:
            self._task = None
        begins = task.from_rest or now >= task.situation.time - _SAME_TIME
        return self._reply.ready and begins

    def take(self, now: float, tick: float) -> Outcome | None:
        """Return the outcome of a search that is complete and whose plan begins at `now` [s].

        A plan that should have begun before the last `tick`, between two samples [s], is none.
        """
        if not self.is_due(now) or self._task is None:
            return None
        task, self._task = self._task, None
        late = now - task.situation.time
        if not task.from_rest and late > max(tick, _LEAST_TICK) + _SAME_TIME:
            self.ahead = min(_GROWTH * self.ahead, self._farthest)
            return None
        result = self._reply.result
        if isinstance(result, NoWay):
            return Outcome(task, None, result.reason)
        return Outcome(task, result)


def later(situation: Situation, hold: FirstOrderHold, time: float, max_step: float) -> Situation:
    """Return the situation at control time `time` [s] if the rotors follow `hold` until then.

    It is predicted in integration steps of up to `max_step` [s].
    """
    now = situation.time
    if time <= now:
        return situation
    knots = hold.times[(hold.times > now) & (hold.times < time)]
    times = np.concatenate(([now], knots, [time]))
    speeds: Vector = np.array([hold.at(float(t)) for t in times])
    state = roll_out(
        situation.state, speeds, np.diff(times), situation.constants.as_array(), max_step,
        situation.disturbance,
    )[-1]
    goal = situation.goal_after(time - now)
    return replace(situation, time=time, state=state, input_in_force=speeds[-1], goal=goal)
