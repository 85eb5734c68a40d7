# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Search for plans, in line or by a worker while the control loop follows a plan or rests.

What a search finds is a plan that begins in the state predicted for a time somewhat ahead: until
then the loop goes on as before. In line nothing is ahead.
"""

import itertools
import math
import time
from dataclasses import replace

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.course import LegEnd
from sphere_nmpc.model.first_order_hold import SHORTEST
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.model.units import RobotUnits
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.in_force import InForce
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver
from sphere_nmpc.strategy.time_optimal.search_task import SearchTask, solver_for
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.steady_rolling import slowed
from sphere_nmpc.worker.contract import Reply, Worker
from sphere_nmpc.worker.in_line import InLine

_TIME_AHEAD_GROWTH = 2.0
"""Factor on the time ahead after a search that was not complete in time."""
_MIN_TICK = 0.02
"""Delay [s] by which a plan may begin later at the highest control rates, too."""
_MAX_SPEED_RATIO = 1.6
"""Largest rotor speed that is searched with over that of the unit of speed, where this is less
than the limit of the drives [-]. With 400 rad/s^2 a goal at 1.4 m took 1.89 s with 1, 1.97 s with
1.5, 1.78 s with 1.6, 1.77 s with 2; one at 7.8 m 6.49, 4.98, 5.34 s, and never with 2."""


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
        fastest = min(robot.max_rotor_speed, _MAX_SPEED_RATIO * RobotUnits.of(robot).max_speed)
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
        known = task.known
        return (known is None or known.leg.end is LegEnd.THROUGH) and not task.is_next

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
        from_rest: bool = False, known: Plan | None = None, is_new: bool = True,
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
        allowed = max(self._settings.control_period, _MIN_TICK) + SHORTEST
        if not task.from_rest and late > allowed:
            self._ahead = min(_TIME_AHEAD_GROWTH * self._ahead, 2.0 * self._tuning.longest_search)
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
