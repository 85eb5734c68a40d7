# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Schedulers: when to plan, for which instant, and within which wall time.

In real time a timer triggers plans, and time advances meanwhile; in lockstep simulated time waits
for each command.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.control.recent import Recent
from sphere_nmpc.control.timing import MOST_AHEAD, ClockWatch
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.settings import ControllerSettings

_AT_REST = FirstOrderHold.constant(0.0, np.zeros(INPUT_SIZE))
_EARLY = 0.25
"""How much before its instant a tick may appear to be, in periods: the first one may be late.
One may be late by up to the rest of a period before it counts for the next instant."""
PLANNING_SHARE = 0.4
"""Share of the control period that planning may take, and by which a plan is made ahead at most;
the rest is for other processes."""
_LEAST_SHARE = 0.1
"""Share of the control period that planning may take at any tick, however late it is."""
_RECENT = 32
"""Newest plans, of which the next one is expected to take no longer than the longest."""
_NEGLIGIBLE = 0.02
"""Share of the control period up to which a command counts as sent at its instant."""


@dataclass(frozen=True, eq=False)
class TimedPose:
    """A measured state, shape (6,), with its stamp [ns] and the same as control time [s]."""

    stamp: int
    time: float
    state: Vector


@dataclass(frozen=True)
class PlanRequest:
    """A plan that is due.

    Attributes
    ----------
    instant : float
        Control time that the plan is made for [s].
    now : float
        Control time at which planning begins [s].
    time_budget : float
        Wall time that the plan may take [s].
    """

    instant: float
    now: float
    time_budget: float


@dataclass(frozen=True)
class Actions:
    """Reactions to an event, to be carried out in the order of the attributes.

    Attributes
    ----------
    refused : float or None
        How far the stamp of a refused pose is ahead of the clock [s].
    observe : TimedPose or None
        A pose to pass to the controller.
    repeat : bool
        Whether to send the last command again.
    plan : PlanRequest or None
        A plan to make and to send.
    """

    refused: float | None = None
    observe: TimedPose | None = None
    repeat: bool = False
    plan: PlanRequest | None = None


NOTHING = Actions()


class Schedule:
    """Scheduler of plans; its owner reports events to it and carries out the `Actions` returned.

    Control times are seconds on the node's clock. An event that a scheduler does not override
    leads to nothing.
    """

    is_real_time = True
    """Whether control time advances while a plan is made."""
    window = 0.0
    """Commitment window: delay of commands for which plans are made further ahead [s]."""
    timer_period: float | None = None
    """Control time between two calls of `tick` [s]; None if no timer is needed."""
    starting = False
    """Whether the next plan is the first one towards a goal, so that `start` may not wait."""
    missed = 0
    """Sampling instants that passed without a tick."""

    def pose_age(self, time: float, now: float | None) -> float:
        """Return the age at `now` of a pose of control time `time` [s]; nan if irrelevant."""
        return math.nan

    def pose_received(self, pose: TimedPose, now: float | None) -> Actions:
        """Return what a pose leads to that arrives at control time `now`, None if unknown."""
        raise NotImplementedError

    def tick(self, now: float) -> Actions:
        """Return what a tick of the timer at control time `now` leads to."""
        return NOTHING

    def start(self, now: float, awaits_start: Callable[[float], bool]) -> Actions | None:
        """Return what to do to start towards a goal now; None if nothing is to be done yet.

        The timer has to be restarted when there is something to do. `awaits_start` returns
        whether at a control time [s] there is a goal to start for and the rotors are at rest.
        """
        return None

    def restart(self, now: float) -> Actions:
        """Return what to do to plan now, whatever the sampling instants so far.

        The timer has to be restarted.
        """
        return NOTHING

    def command_time(self, request: PlanRequest, elapsed: float) -> float:
        """Return the control time [s] from which the command of a plan applies.

        `elapsed` is the wall time since planning began [s].
        """
        return request.now

    def command(self, request: PlanRequest, hold: FirstOrderHold | None) -> FirstOrderHold | None:
        """Return what to send where the controller has committed `hold`, None being nothing."""
        return hold

    def completed(self, duration: float, solved: bool) -> None:
        """Record a plan that took `duration` from its request to its command [s, wall]."""

    def final_request(self, now: float) -> PlanRequest:
        """Return a request for control time `now` [s], whatever the sampling instants."""
        return PlanRequest(now, now, math.inf)

    def goal_changed(self) -> None:
        """Prepare for the first plan towards a new goal."""

    def enabled(self) -> None:
        """Prepare for the first plan after the controller was enabled."""

    def disabled(self, now: float | None) -> Actions:
        """Return what to do at control time `now` because the controller was disabled."""
        return NOTHING

    def clock_jumped(self, watch: ClockWatch) -> None:
        """Restart after a jump of control time, or on the clock of another `watch`."""
        self.goal_changed()

    def refusal(self, settings: ControllerSettings) -> str | None:
        """Return why a change to `settings` is impossible while running; None if it is not."""
        return None

    def change(self, settings: ControllerSettings) -> None:
        """Apply settings that may change while running."""


class ClockedSchedule(Schedule):
    """Scheduler in real time: a plan at each instant of a sample grid, within part of its period.

    A timer fires late by chance, but never early, so that the earliest phase of its ticks counts
    for the grid. A plan is made for the time at which its command will be ready, predicted from
    recent durations: one that takes effect then is followed exactly, while a command that is late
    has to start from the rotor speeds at that time, and departs from its plan. The first plan
    towards a goal does not wait for the next instant: it begins a new grid.

    Parameters
    ----------
    settings : ControllerSettings
        Strategy, rates, and how far a pose may be ahead of the clock (``pose_timeout``).
    watch : ClockWatch
        Pace of control time.
    """

    def __init__(self, settings: ControllerSettings, watch: ClockWatch) -> None:
        self.timer_period = self._period = settings.control_period
        self._pose_timeout = settings.pose_timeout
        self._watch = watch
        self._origin: float | None = None
        self._last = 0
        self._took = Recent(_RECENT)
        self.starting = True
        self._late = 0.0
        self._pose_ahead: TimedPose | None = None

    def pose_age(self, time: float, now: float | None) -> float:
        """Return the age at `now` of a pose of control time `time` [s]; nan if unknown."""
        return math.nan if now is None else now - time

    def pose_received(self, pose: TimedPose, now: float | None) -> Actions:
        """Return whether to observe a pose; one ahead of the clock is kept for the next tick.

        When the node was held up, the clock message of that instant may be next in the queue.
        """
        if now is None:
            return NOTHING
        if self._is_ahead(pose, now):
            self._pose_ahead = pose
            return NOTHING
        return Actions(observe=pose)

    def tick(self, now: float) -> Actions:
        """Return the request for the sampling instant of a tick, with a pose that was kept.

        A pose that is still ahead of the clock is refused: it would count as fresh until the
        clock reaches its stamp.
        """
        pose, self._pose_ahead = self._pose_ahead, None
        refused = None
        if pose is not None and self._is_ahead(pose, now):
            refused, pose = pose.time - now, None
        instant = self._instant(now)
        self._late = now - instant
        request = self._request(instant, now, self._lead() + self.window)
        return Actions(refused=refused, observe=pose, plan=request)

    def _instant(self, now: float) -> float:
        """Return the sampling instant of a tick at `now` [s], and count those missed before it."""
        period = self._period
        if self._origin is None:
            self._origin, self._last = now, 0
            return now
        k = math.floor((now - self._origin) / period + _EARLY)
        if self._origin + k * period > now:
            self._origin = now - k * period
        self.missed += max(0, k - self._last - 1)
        self._last = k
        return self._origin + k * period

    def _lead(self) -> float:
        """Return the predicted delay of a command behind its instant [s, control time]."""
        expected = self._took.quantile(1.0) if self._took else 0.0
        if expected < _NEGLIGIBLE * self._period:
            return 0.0
        return min(expected, PLANNING_SHARE * self._period)

    def start(self, now: float, awaits_start: Callable[[float], bool]) -> Actions | None:
        """Return the first tick of a new grid if the next plan starts towards a goal.

        The first plan takes longest, so it waits until the pace, and so its time budget, is known.
        """
        if not self.starting or self._watch.pace is None or not awaits_start(now):
            return None
        return self.restart(now)

    def restart(self, now: float) -> Actions:
        """Return the first tick of a new grid."""
        self._origin = None
        return self.tick(now)

    def command_time(self, request: PlanRequest, elapsed: float) -> float:
        """Return the control time [s] now that planning has taken `elapsed` [s, wall].

        A simulated clock shows the same time throughout a callback, while the robot moves. A
        command must not begin long after the clock that is known, whatever pace was measured.
        """
        return request.now + min(elapsed * (self._watch.pace or 0.0), MOST_AHEAD)

    def completed(self, duration: float, solved: bool) -> None:
        """Record a plan that took `duration` from its request to its command [s, wall]."""
        self._took.add(self._late + duration * (self._watch.pace or 1.0))
        self.starting = self.starting and not solved

    def final_request(self, now: float) -> PlanRequest:
        """Return a request for control time `now` [s], whatever the grid."""
        return self._request(now, now, 0.0)

    def goal_changed(self) -> None:
        """Start immediately."""
        self.starting = True

    def enabled(self) -> None:
        """Start as towards a new goal."""
        self.goal_changed()

    def disabled(self, now: float | None) -> Actions:
        """Return a request for now: a stop does not wait for the next sampling instant."""
        return NOTHING if now is None else Actions(plan=self.final_request(now))

    def clock_jumped(self, watch: ClockWatch) -> None:
        """Restart on a new grid; see `Schedule.clock_jumped`."""
        if watch is not self._watch:
            self._watch = watch
            self._took.clear()
        self._pose_ahead = self._origin = None
        self.goal_changed()

    def change(self, settings: ControllerSettings) -> None:
        """Apply new settings; another control period begins a new grid."""
        self._pose_timeout = settings.pose_timeout
        if settings.control_period != self._period:
            self.timer_period = self._period = settings.control_period
            self._took.clear()
            self._origin = None

    def _is_ahead(self, pose: TimedPose, now: float) -> bool:
        return pose.time - now > self._pose_timeout

    def _request(self, instant: float, now: float, lead: float) -> PlanRequest:
        period = self._period
        left = max(instant + PLANNING_SHARE * period - now, _LEAST_SHARE * period)
        return PlanRequest(instant + lead, now, left / (self._watch.pace or 1.0))


class LockstepSchedule(Schedule):
    """Scheduler in lockstep: one plan for each pose of a sampling instant, all are answered.

    A plan may take any wall time, so that results are repeatable. Neither a timer nor the clock of
    the node is needed: the stamp of the pose is the time.

    Parameters
    ----------
    settings : ControllerSettings
        Strategy and rates.
    """

    is_real_time = False

    def __init__(self, settings: ControllerSettings) -> None:
        self._period = settings.control_period
        self._answered: int | None = None

    def pose_received(self, pose: TimedPose, now: float | None) -> Actions:
        """Return the request for the sampling instant of a pose; between instants nothing is done.

        The simulator repeats the pose while it waits. The plan of an instant is made once, its
        command is then sent again.
        """
        if pose.stamp % round(self._period * NANOSECONDS):
            return NOTHING
        if pose.stamp == self._answered:
            return Actions(repeat=True)
        self._answered = pose.stamp
        return Actions(observe=pose, plan=self.final_request(pose.time))

    def command(self, request: PlanRequest, hold: FirstOrderHold | None) -> FirstOrderHold | None:
        """Return the hold, or rest where there is none: the simulator waits for an answer."""
        return _AT_REST.delayed(request.instant) if hold is None else hold

    def goal_changed(self) -> None:
        """Plan for the present instant again, even if it has been answered."""
        self._answered = None

    def refusal(self, settings: ControllerSettings) -> str | None:
        """Return why another control period is impossible: the simulator waits at fixed ones."""
        if settings.control_period == self._period:
            return None
        return (
            f"strategy: given '{settings.strategy}' in lockstep, expected one that samples every "
            f"{self._period:g} s, as the simulator waits for"
        )
