# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Searches that a worker does while the control loop follows a plan, or rests.

The result of a search is a plan that begins a little later, in the state predicted for that time:
until then the loop goes on as before. From rest it may begin at any time.
"""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.roll_out import roll_out_with_momentum
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.planner import ArrivalPlanner
from sphere_nmpc.strategy.time_optimal.search_task import (
    SearchResult,
    SearchTask,
    search_task,
)
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.worker.contract import Reply, Worker

_GROWTH = 2.0
"""Factor on the time ahead after a search that was not complete in time."""
_SAME_TIME = 1e-6
"""Rounding of control times [s]."""
_LEAST_TICK = 0.02
"""Delay [s] by which a plan may begin later at the highest control rates, too."""


class Purpose(Enum):
    """What a search is for."""

    NEW = "a plan where there is none"
    EARLIER = "an earlier arrival than that of the plan"
    REDIRECT = "a plan to another goal, while one is followed"


@dataclass(frozen=True, eq=False)
class Outcome:
    """A search that is complete, with what it was for.

    Attributes
    ----------
    purpose : Purpose
        What it was for.
    result : SearchResult
        What it has found.
    situation : Situation
        Situation in which the plan begins.
    planner : ArrivalPlanner
        Planner with the limits of the search.
    from_rest : bool
        Whether the plan may begin at any time.
    is_late : bool
        Whether it should have begun before.
    """

    purpose: Purpose
    result: SearchResult
    situation: Situation
    planner: ArrivalPlanner
    from_rest: bool
    is_late: bool

    def begins_in(self, situation: Situation) -> bool:
        """Return whether the plan begins in this situation, whatever the time.

        A sphere at rest may have been moved since, and what is estimated of it may have changed.
        """
        return all(
            np.array_equal(planned, now)
            for planned, now in zip(
                _where(self.situation), _where(situation), strict=True
            )
        )


def _where(situation: Situation) -> tuple[Vector, ...]:
    drift = situation.drift.as_array()
    return situation.state, situation.input_in_force, situation.constants.as_array(), drift


@dataclass(frozen=True, eq=False)
class _UnderWay:
    reply: Reply[SearchResult]
    task: SearchTask
    purpose: Purpose
    planner: ArrivalPlanner
    from_rest: bool


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
        self._under_way: _UnderWay | None = None
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
        self,
        purpose: Purpose,
        planner: ArrivalPlanner,
        situation: Situation,
        effort: int,
        growth: float = 1.0,
        from_rest: bool = False,
        strict: bool = False,
        known: FirstOrderHold | None = None,
    ) -> None:
        """Begin a search for a plan from `situation`; one under way is forgotten.

        Parameters as for `SearchTask`, effort and longest time times `growth`; `from_rest` as for
        `Outcome`.
        """
        origin = situation.time if known is None else planner.grid.origin(situation.time)
        longest = growth * self._tuning.longest_search
        task = search_task(
            planner, situation, origin, round(growth * effort), longest, strict, known
        )
        reply = self._worker.submit(task)
        self._under_way = None
        if reply.pending or reply.ready:
            self._under_way = _UnderWay(reply, task, purpose, planner, from_rest)

    def is_due(self, now: float) -> bool:
        """Return whether `take` returns a result at `now` [s]."""
        search = self._under_way
        if search is None:
            return False
        self._worker.poll()
        if search.reply.error:
            self._under_way = None
        due = search.from_rest or now >= search.task.situation.time - _SAME_TIME
        return search.reply.ready and due

    def take(self, now: float, tick: float) -> Outcome | None:
        """Return the search under way once it is complete and its plan begins; else None.

        Parameters
        ----------
        now : float
            Control time [s].
        tick : float
            Time between two samples [s]: a plan that begins within the last one is not late.
        """
        search = self._under_way
        if search is None or not self.is_due(now):
            return None
        self._under_way, result = None, search.reply.result
        if result is None:
            return None
        late = now - search.task.situation.time
        is_late = not search.from_rest and late > max(tick, _LEAST_TICK) + _SAME_TIME
        if is_late:
            self.ahead = min(_GROWTH * self.ahead, self._tuning.search_farthest_ahead)
        return Outcome(
            search.purpose, result, search.task.situation, search.planner, search.from_rest,
            is_late,
        )


def later(situation: Situation, hold: FirstOrderHold, time: float, max_step: float) -> Situation:
    """Return the situation at control time `time` [s] if the rotors follow `hold` until then.

    Parameters
    ----------
    situation : Situation
        Situation now.
    hold : FirstOrderHold
        Rotor speeds over control time, from now on.
    time : float
        Control time [s], not before that of `situation`.
    max_step : float
        Longest integration step [s].
    """
    now = situation.time
    if time <= now:
        return situation
    knots = hold.times[(hold.times > now) & (hold.times < time)]
    times = np.concatenate(([now], knots, [time]))
    speeds = np.array([hold.at(float(t)) for t in times])
    states, momenta = roll_out_with_momentum(
        situation.state, situation.drift, speeds, np.diff(times),
        situation.constants.as_array(), max_step,
    )
    drift = situation.drift
    if not drift.is_zero:
        drift = replace(drift, momentum=momenta[-1].copy())
    return replace(
        situation, time=time, state=states[-1], input_in_force=speeds[-1], drift=drift
    )
