# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""One search for a plan, with all that it depends on, so that it can be done in any process."""

import math
import time
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from sphere_nmpc.model.course import LegEnd
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, POSITION, Vector
from sphere_nmpc.strategy.clearance import Margin, is_clear
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver, rolled_out
from sphere_nmpc.strategy.time_optimal.chain import extended, later, replanned
from sphere_nmpc.strategy.time_optimal.guide import Guide, with_lines
from sphere_nmpc.strategy.time_optimal.knots import Grid
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.steady_rolling import slowed
from sphere_nmpc.worker.contract import Store

_SEARCH_SHARE = 0.75
"""Share of the wall time of a search after which the motors are spared with what it has found."""
_LONGEST_PART, _SHORTEST_PART = 8.75, 0.4
"""Duration of the parts of a plan that are searched for anew [1 / (c1 u_max)], and least share of
it. A shorter plan is searched for as a whole, by a round: where commands are late, more of
them would change the last manoeuvre at each sample."""
_PARTS_SHARE = 0.5
"""Share of the effort of a search for which parts of a chain are searched for."""
_MOST_FAILED = 4
"""Failed searches that count at most where a plan is led on, so that the next place is no nearer
than about one radius."""


@lru_cache(maxsize=8)
def solver_for(robot: RobotParameters, tuning: TimeOptimalSettings) -> ArrivalSolver:
    """Return the solver for a robot, whose limits may be less than those of its drives."""
    return ArrivalSolver(robot, Grid.of(robot, tuning.spacing), tuning)


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
        Situation in which the plan begins, at time 0 and with its leg alone: a course may be long.
    seed : int
        Seed of the initial guesses, and number of the motion that is found.
    effort : int
        Planning effort of a new plan.
    longest : float
        Wall time at which the search stops [s].
    from_rest : bool
        Whether the sphere rests until the plan begins, which may then be at any time.
    known : Plan or None
        Rest of the plan that is being followed to the same goal, from time 0 on: an earlier
        arrival is searched for. None for a new plan.
    failed : int
        Searches before it that have found nothing; a goal on the way around obstacles is then
        nearer.
    rested : ndarray of shape (2,), or None
        Where the sphere has last rested [m], from which a part of the way has to lead on; None
        where it is now.
    is_next : bool
        Whether it is for the leg after the one that is followed, from the end of that.
    margin : float
        Share of the least time that a new plan may take longer, to spare the motors.
    asked : float
        Time at which it is to arrive [s]; -inf where that follows from the margin.
    spared : float
        Time by which the plan that is known arrives later [s], to spare the motors.
    """

    robot: RobotParameters
    tuning: TimeOptimalSettings
    situation: Situation
    seed: int
    effort: int
    longest: float
    from_rest: bool = False
    known: Plan | None = None
    failed: int = 0
    rested: Vector | None = None
    is_next: bool = False
    margin: float = 0.0
    asked: float = -math.inf
    spared: float = 0.0

    @property
    def solver(self) -> ArrivalSolver:
        """Solver with its limits of the drives."""
        return solver_for(self.robot, self.tuning)

    def __call__(self, store: Store | None = None) -> Plan | str:
        """Return the plan, from time 0 on, with the earliest arrival that is found.

        It is another one than that which is known. Without one it is why there is none wherever
        one searches; empty where that is not so.
        """
        began = time.perf_counter()
        is_paced = self.margin > 0.0 or self.spared > 0.0 or self.asked > -math.inf
        end = began + (_SEARCH_SHARE if is_paced else 1.0) * self.longest
        found = self._new(end) if self.known is None else self._earlier(self.known, end)
        if not isinstance(found, Plan):
            return found or ""
        if is_paced and found.leg.end is LegEnd.REST:
            found = self._paced(self.situation, found, began + self.longest)
        return replace(found, made=replace(found.made, motion=self.seed))

    @property
    def _longest_part(self) -> float:
        return _LONGEST_PART * self.solver.grid.unit

    @property
    def _guide(self) -> Guide:
        return Guide(self.situation, self.solver, self.rested)

    def _new(self, end: float) -> Plan | str | None:
        situation, guide = self.situation, self._guide
        guidance = guide.guidance(self.failed)
        if guidance.reason:
            return guidance.reason
        for aim in guidance.aims:
            search = ArrivalSearch(self.solver, aim.situation, self.seed, detour=aim.detour)
            found = search.improve(int(aim.share * self.effort), end)
            if found is not None and not aim.is_local:
                return found
            if found is not None and guide.leads_on(found):
                return guide.on_the_way(found)
        if not guidance.by_lines or not situation.has_small_momentum:
            return None  # lines are those of a sphere without momentum
        found = self._by_lines(situation, guide, end) if guidance.sees_goal else None
        if found is None and self.from_rest:
            line = guide.line_on()
            return None if line is None else guide.on_the_way(line)
        return found

    def _earlier(self, known: Plan, end: float) -> Plan | str | None:
        """Return a plan that is better than the one that is known; None without one."""
        situation = self.situation
        is_passed = known.leg.end is LegEnd.THROUGH
        in_parts = not (situation.floor.is_empty or situation.goal.rate.any())
        in_parts &= situation.has_small_momentum
        if is_passed and not in_parts:
            return self._new(end)
        start = self._kept(known)
        if start.error > self.tuning.arrival_error:
            return None
        in_parts &= start.duration > self._longest_part and not (start.made.turns or self.spared)
        if in_parts or is_passed:
            best = self._in_parts(start, end)
        else:
            detour = self._guide.detour()
            search = ArrivalSearch(self.solver, situation, self.seed, start, detour)
            best = search.improve_once(end) or start
        return best if best.cost + self.spared < start.cost else None

    def _kept(self, known: Plan) -> Plan:
        """Return the plan that is known, in the situation in which it is to begin.

        One to the goal is solved again. Where another one leads to is as good a place on the way
        as that which was aimed at.
        """
        situation = self.situation
        if known.leg.end is LegEnd.THROUGH:
            start = rolled_out(known, situation, known.hold)
            goal = replace(start.leg.goal, pose=start.states[-1, POSE].copy())
            return replace(start, leg=replace(known.leg, goal=goal), error=0.0)
        start = self.solver.solve(
            situation, situation.goal, known.hold, budget=self.longest, kept=True
        )
        return replace(start, leg=replace(known.leg, goal=start.leg.goal))

    def _in_parts(self, plan: Plan, end: float) -> Plan:
        """Return a plan that leads on from a state of the given one, and of which parts are new.

        It is the given one where that is the best.
        """
        situation, solver = self.situation, self.solver
        rng, work = np.random.default_rng(self.seed), 0
        if plan.leg.end is LegEnd.THROUGH:
            plan = _better(plan, self._led_on(plan, rng, end))
        while plan.hold.end > self._longest_part and work < _PARTS_SHARE * self.effort:
            if time.perf_counter() > end:
                break
            times, length = plan.hold.times, self._longest_part * rng.uniform(_SHORTEST_PART, 1.0)
            begin = rng.uniform(-0.5 * length, plan.hold.end - 0.5 * length)
            begin = min(max(0.0, begin), plan.hold.end - length)
            begin, until = (
                float(times[np.argmin(np.abs(times - each))]) for each in (begin, begin + length)
            )
            seed = int(rng.integers(2**31))
            whole, spent = replanned(situation, plan, begin, until, solver, seed, end)
            plan, work = _better(plan, whole), work + spent
        return plan

    def _led_on(self, plan: Plan, rng: np.random.Generator, end: float) -> Plan | None:
        """Return a plan that leads on from a state of the given one; None without one."""
        situation, solver, until = self.situation, self.solver, plan.hold.end
        begin = max(0.0, until - self._longest_part * rng.random())
        failed = int(rng.integers(min(self.failed, _MOST_FAILED) + 1))
        if failed and rng.integers(2):
            begin = until  # where it rests, straight lines lead on from a narrow place, too
        there = later(situation, plan.hold, begin, solver.grid.fine).from_zero()
        rested = situation.state[POSITION] if self.rested is None else self.rested
        task = replace(
            self, situation=there, failed=failed, from_rest=begin == until, rested=rested
        )
        further = task._new(end)
        if not isinstance(further, Plan):
            return None
        return extended(situation, plan, begin, further, solver) if begin > 0.0 else further

    def _paced(self, situation: Situation, found: Plan, end: float) -> Plan:
        """Return a plan that spares the motors near the one found; without one that itself."""
        margin, longer = self.margin, 0.0
        if self.asked > -math.inf:
            margin, longer = 0.0, max(0.0, self.asked - found.end)
        elif self.known is not None and self.known.leg.end is LegEnd.REST:
            margin, longer = 0.0, self.spared
        slower = slowed(found.hold, found.made.turns > 0, margin, longer)
        spared = slower.end - found.end
        for plan in self.solver.spared(situation, found, slower, end) if spared > 0.0 else ():
            is_there = plan.error <= self.tuning.arrival_error
            if is_there and is_clear(situation, plan.hold, Margin.FOUND):
                return replace(plan, asked=slower.end, spared=spared)
        return replace(found, asked=self.asked)

    def _by_lines(self, situation: Situation, guide: Guide, end: float) -> Plan | None:
        """Return a plan to the goal that ends with straight lines to it."""
        lines = guide.lines_to_goal()
        if lines is None:
            return None
        aimed = situation.aimed_at(Goal(lines[0]))
        found = ArrivalSearch(self.solver, aimed, self.seed).improve(self.effort, end)
        return None if found is None else with_lines(situation, found, lines[1])


def _better(plan: Plan, other: Plan | None) -> Plan:
    """Return another plan where there is one and it costs less."""
    return plan if other is None or other.cost >= plan.cost else other
