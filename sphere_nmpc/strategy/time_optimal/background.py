# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Search for plans, in line or by a worker while the control loop follows a plan or rests.

A search has all that it depends on, so that it can be done in any process. What it finds is a plan
that begins in the state predicted for a time somewhat ahead: until then the loop goes on as
before. In line nothing is ahead.
"""

import itertools
import math
import time
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.course import LegEnd
from sphere_nmpc.model.first_order_hold import SHORTEST, FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.model.units import RobotUnits
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.clearance import Margin, is_clear
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.in_force import InForce
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver
from sphere_nmpc.strategy.time_optimal.guide import Guide, with_lines
from sphere_nmpc.strategy.time_optimal.knots import Grid
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.steady_rolling import slowed
from sphere_nmpc.worker.contract import Reply, Store, Worker
from sphere_nmpc.worker.in_line import InLine

_GROWTH = 2.0
"""Factor on the time ahead after a search that was not complete in time."""
_SEARCHING = 0.75
"""Share of the wall time of a search after which the motors are spared with what it has found."""
_LEAST_TICK = 0.02
"""Delay [s] by which a plan may begin later at the highest control rates, too."""


_FASTEST = 1.6
"""Largest rotor speed that is searched with over that of the unit of speed, where this is less
than the limit of the drives [-]. With 400 rad/s^2 a goal at 1.4 m took 1.89 s with 1, 1.97 s with
1.5, 1.78 s with 1.6, 1.77 s with 2; one at 7.8 m 6.49, 4.98, 5.34 s, and never with 2."""


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
    known : FirstOrderHold or None
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
    known: FirstOrderHold | None = None
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
        began, situation = time.perf_counter(), self.situation
        is_paced = self.margin > 0.0 or self.spared > 0.0 or self.asked > -math.inf
        end = began + (_SEARCHING if is_paced else 1.0) * self.longest
        guide = Guide(situation, self.solver, self.rested)
        if self.known is None:
            found = self._new(situation, guide, end)
        else:
            found = self._earlier(situation, guide, self.known, end)
        if not isinstance(found, Plan):
            return found or ""
        if is_paced and found.leg.end is LegEnd.REST:
            found = self._paced(situation, found, began + self.longest)
        return replace(found, made=replace(found.made, motion=self.seed))

    def _new(self, situation: Situation, guide: Guide, end: float) -> Plan | str | None:
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

    def _earlier(
        self, situation: Situation, guide: Guide, known: FirstOrderHold, end: float
    ) -> Plan | None:
        """Return a plan with an earlier arrival than the one that is known; None without one."""
        solver, goal = self.solver, situation.goal
        start = solver.solve(situation, goal, known, budget=self.longest, kept=True)
        if start.error > self.tuning.arrival_error:
            return None
        search = ArrivalSearch(solver, situation, self.seed, start, guide.detour())
        found = search.improve_once(end)
        if found is start or found is None or found.duration + self.spared >= start.duration:
            return None
        return found

    def _paced(self, situation: Situation, found: Plan, end: float) -> Plan:
        """Return a plan that spares the motors near the one found; without one that itself."""
        margin, longer = self.margin, 0.0
        if self.asked > -math.inf:
            margin, longer = 0.0, max(0.0, self.asked - found.end)
        elif self.known is not None:
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


class BackgroundSearch:
    """Search for plans, one at a time, of which the state machine asks what has been found.

    Parameters
    ----------
    settings : ControllerSettings
        Sample period, control rate, planning effort.
    robot : RobotParameters
        Limits of the drives.
    tuning : TimeOptimalSettings
        Tuning of the searches.
    """

    def __init__(
        self, settings: ControllerSettings, robot: RobotParameters, tuning: TimeOptimalSettings
    ) -> None:
        self._settings, self._robot, self._tuning = settings, robot, tuning
        self._in_line = InLine()
        self._worker: Worker = self._in_line
        self._ahead = 0.0
        self._reply: Reply[Plan | str] = Reply()
        self.reset()

    def work_by(self, worker: Worker) -> None:
        """Search by a worker from now on; in line while there is none to be had."""
        self._worker, self._ahead = worker, self._tuning.search_ahead

    def change(self, settings: ControllerSettings) -> None:
        """Use another planning effort from the next search on."""
        self._settings = settings

    def reset(self) -> None:
        """Forget all searches, and what the drives attain."""
        self.solver = self._solver_with(1.0)
        """Solver with the acceleration that the drives attain, for new plans."""
        self._task: tuple[SearchTask, Situation] | None = None
        """The search under way, and the situation at the control time at which its plan begins."""
        self._seeds = itertools.count(1)
        self.improved_at = -math.inf
        """Control time at which a search that is not urgent has begun [s]."""
        self.failed = 0
        """Searches in succession that have found nothing, in the present state."""
        self.failed_ahead = 0
        """The same of searches for the next leg."""
        self._has_failed = False
        self.no_way = ""
        """Why there is no way to the goal, as the last search has found; empty otherwise."""
        self._no_way_on: Floor | None = None

    def solver_from(self, situation: Situation) -> ArrivalSolver:
        """Return the solver for a new plan; where the sphere has slipped it accelerates less."""
        slip = self._tuning.slip_acceleration
        return self._solver_with(slip) if situation.plant.slippery else self.solver

    def _solver_with(self, share: float) -> ArrivalSolver:
        """Return a solver with this share of the limit of the rotors' acceleration.

        Speeds to which a ramp takes too long are not planned with: between two knots, which are
        half a ramp apart, the sphere would turn several times.
        """
        robot = self._robot
        limit = share * robot.max_rotor_acceleration
        fastest = min(robot.max_rotor_speed, _FASTEST * RobotUnits.of(robot).max_speed)
        limited = replace(robot, max_rotor_acceleration=limit, max_rotor_speed=fastest)
        return solver_for(limited, self._tuning)

    def use_attained(self, acceleration: float) -> None:
        """Search with the acceleration [rad/s^2] that the drives attain, unless as before."""
        tuning, limit = self._tuning, self._robot.max_rotor_acceleration
        share = min(1.0, tuning.attained_share * acceleration / limit)
        share = max(share, tuning.slip_acceleration)
        before = self.solver.robot.max_rotor_acceleration / limit
        if abs(share - before) > (1.0 - tuning.attained_share) * share:
            self.solver = self._solver_with(share)

    def cancel(self) -> None:
        """Forget the search under way and those that have failed."""
        self._task, self.failed = None, 0

    def begin_leg(self) -> None:
        """Count failed searches from the beginning of a leg on."""
        self.failed = self.failed_ahead = 0

    def count_anew(self) -> None:
        """Count failed searches from the present sampling instant on, this one included."""
        self.failed = int(self._has_failed)

    @property
    def _by(self) -> Worker:
        """What searches now: the worker, if there is one to be had."""
        return self._worker if self._worker.available else self._in_line

    @property
    def ahead(self) -> float:
        """Time from the request of a search to the start of its plan [s, control time]."""
        return 0.0 if self._by is self._in_line else self._ahead

    @property
    def is_busy(self) -> bool:
        """Whether a search is under way."""
        return self._task is not None

    @property
    def is_awaited(self) -> bool:
        """Whether a search is under way for another plan than one that arrives earlier."""
        if self._task is None:
            return False
        task, _ = self._task
        return task.known is None and not task.is_next

    def begins(self, now: float) -> float:
        """Return the control time at which the plan of a search that begins now starts [s]."""
        ahead = self.ahead
        return now + (max(ahead, self._settings.control_period) if ahead else 0.0)

    def a_period_after(self, time: float) -> float:
        """Return the control time after which the instant a sample period later is [s]."""
        return time + self._settings.period - 0.5 * self._settings.control_period

    @property
    def next_at(self) -> float:
        """Control time from which on the next search that is not urgent begins [s]."""
        return self.a_period_after(self.improved_at)

    def may_find(self, situation: Situation) -> bool:
        """Return whether to search; where there was no way on this floor, once a period."""
        if not self.no_way or self._no_way_on is not situation.floor:
            return True
        now = situation.time
        is_due = now > self.next_at
        if is_due:
            self.improved_at = now
        return is_due

    def begin(
        self, start: Situation, solver: ArrivalSolver, deadline: float, rested: Vector | None,
        from_rest: bool = False, known: FirstOrderHold | None = None, is_new: bool = True,
        is_next: bool = False, leg_began: float = -math.inf, spared: float = 0.0,
    ) -> None:
        """Begin a search; see `SearchTask`.

        `deadline` is the steady clock reading [s] at which one in line stops. It `is_new` unless
        a plan to the goal itself is followed: failed searches then make the local goal nearer.
        `leg_began` is the control time at which the leg has begun [s].
        """
        worker, tuning = self._by, self._tuning
        # In motion the next search has another problem, which may be easier.
        failed = self.failed_ahead if is_next else self.failed
        growth = tuning.growth(failed) if from_rest else 1.0
        longest = growth * tuning.longest_search
        if worker is self._in_line:
            longest = deadline - time.perf_counter()
        settings = self._settings
        asked = leg_began + settings.arrive_at - start.time if settings.arrive_at else -math.inf
        task = SearchTask(
            solver.robot, tuning, start.from_zero(), next(self._seeds),
            round(growth * settings.planning_effort), longest, from_rest,
            None if known is None else known.delayed(-start.time), failed if is_new else 0, rested,
            is_next, settings.time_margin, asked, spared,
        )
        self._reply = worker.submit(task)
        self._task = None if self._reply.error else (task, start)

    def is_due(self, now: float) -> bool:
        """Return whether `take` returns what a search has found at `now` [s]."""
        if self._task is None:
            return False
        task, start = self._task
        self._worker.poll()
        if self._reply.error:
            self._task = None
        return self._reply.ready and (task.from_rest or now >= start.time - SHORTEST)

    def take(self, now: float) -> tuple[InForce, bool] | None:
        """Return the plan of a search that is complete, and whether it is for the next leg.

        It begins at `now` [s], one for the next leg at any time. None if there is none, or it has
        found nothing. A plan that should have begun before the last sampling instant is none.
        """
        self._has_failed = False
        if not self.is_due(now) or self._task is None:
            return None
        (task, start), self._task = self._task, None
        late = now - start.time
        allowed = max(self._settings.control_period, _LEAST_TICK) + SHORTEST
        if not task.from_rest and late > allowed:
            self._ahead = min(_GROWTH * self._ahead, 2.0 * self._tuning.longest_search)
            return None
        found = self._reply.result
        if isinstance(found, Plan):
            if task.is_next:
                self.failed_ahead = 0
            else:
                self.no_way, self._no_way_on = "", None
                if task.from_rest and task.asked > -math.inf:
                    found = _sooner(found, min(late, found.spared))
            plan = found.delayed(now if task.from_rest else start.time)
            return InForce(plan, start, task.robot, task.rested), task.is_next
        if task.is_next:
            self.failed_ahead += 1
            return None
        self.no_way, self._no_way_on = found or "", start.floor
        self._has_failed = not found
        self.failed += self._has_failed
        return None


def _sooner(plan: Plan, earlier: float) -> Plan:
    """Return a plan that arrives `earlier` [s], along the same path."""
    hold = slowed(plan.hold, plan.made.turns > 0, longer=-earlier)
    goal = replace(plan.leg.goal, since=hold.end)
    return replace(
        plan, hold=hold, leg=replace(plan.leg, goal=goal), asked=plan.asked - earlier,
        spared=plan.spared - earlier,
    )


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
    in_force = hold.starting_at(time, speeds[-1])
    return replace(situation, time=time, state=state, in_force=in_force)
