# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Schedulers: when to plan, for which instant, and within which wall time.

In real time a timer triggers plans, and time advances meanwhile; in lockstep simulated time waits
for each command.
"""

import math
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.control.timing import MOST_AHEAD, ClockWatch
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.reporting.recent import Recent
from sphere_nmpc.settings import ControllerSettings

_AT_REST = FirstOrderHold.constant(0.0, np.zeros(INPUT_SIZE))
_MAX_EARLINESS = 0.25
"""How much before its instant a tick may appear to be, in periods: the first one may be late.
One may be late by up to the rest of a period before it counts for the next instant."""
PLANNING_SHARE = 0.4
"""Share of the control period that planning may take, and by which a plan is made ahead at most;
the rest is for other processes."""
_MIN_PLANNING_SHARE = 0.1
"""Share of the control period that planning may take at any tick, however late it is."""
_NEGLIGIBLE_DELAY_SHARE = 0.02
"""Share of the control period up to which a command counts as sent at its instant."""


@dataclass(frozen=True, eq=False)
class TimedPose:
    """A measured state, shape (6,), with its stamp [ns] and the same as control time [s]."""

    stamp: int
    time: float
    state: Vector


@dataclass(frozen=True)
class PlanRequest:
    """A plan that is due."""

    instant: float
    """Control time that the plan is made for [s]."""
    now: float
    """Control time at which planning begins [s]."""
    time_budget: float
    """Wall time that the plan may take [s]."""


class Schedule:
    """Scheduler in real time: a plan at each instant of a sample grid, within part of its period.

    A timer fires late by chance, but never early, so that the earliest phase of its ticks counts
    for the grid. A plan is made for the time at which its command will be ready, predicted from
    recent durations: one that takes effect then is followed exactly, while a command that is late
    has to start from the rotor speeds at that time, and departs from its plan. The first plan
    towards a goal does not wait for the next instant: it begins a new grid.

    Control times are seconds on the node's clock.

    Parameters
    ----------
    settings : ControllerSettings
        Strategy, rates, and how far a pose may be ahead of the clock (``pose_timeout``).
    watch : ClockWatch
        Pace of control time.
    """

    is_real_time = True
    """Whether control time advances while a plan is made."""
    window = 0.0
    """Commitment window: delay of commands for which plans are made further ahead [s]."""
    timer_period: float | None
    """Control time between two calls of `tick` [s]; None if plans are made for poses."""

    def __init__(self, settings: ControllerSettings, watch: ClockWatch) -> None:
        self.timer_period = self._period = settings.control_period
        self._pose_timeout = settings.pose_timeout
        self._watch = watch
        self._origin: float | None = None
        self._last = 0
        self._took = Recent()
        """Durations of the newest plans; the next one is expected to take no longer than these."""
        self.starting = True
        """Whether the next plan is the first one towards a goal."""
        self.answered: int | None = None
        """Stamp of the pose whose command is sent again where the pose is [ns]; only in lockstep,
        where the simulator repeats it while it waits, but its plan is made once."""
        self.missed = 0
        """Sampling instants that passed without a tick."""
        self.kept: TimedPose | None = None
        """Pose that was ahead of the clock when it arrived, for the next tick."""
        self._late = 0.0

    def is_ahead(self, pose: TimedPose, now: float) -> bool:
        """Return whether a pose would count as fresh until the clock reaches its stamp."""
        return pose.time - now > self._pose_timeout

    def pose_received(self, pose: TimedPose, now: float | None) -> bool:
        """Return whether to observe a pose; one ahead of the clock is kept for the next tick.

        When the node was held up, the clock message of that instant may be next in the queue.
        """
        if now is None:
            return False
        if self.is_ahead(pose, now):
            self.kept = pose
            return False
        return True

    def tick(self, now: float) -> PlanRequest:
        """Return the request for the sampling instant of a tick, by when `kept` has been used."""
        self.kept = None
        instant = self._instant(now)
        self._late = now - instant
        return self._request(instant, now, self._lead() + self.window)

    def _instant(self, now: float) -> float:
        """Return the sampling instant of a tick at `now` [s], and count those missed before it."""
        period = self._period
        if self._origin is None:
            self._origin, self._last = now, 0
            return now
        k = math.floor((now - self._origin) / period + _MAX_EARLINESS)
        if self._origin + k * period > now:
            self._origin = now - k * period
        self.missed += max(0, k - self._last - 1)
        self._last = k
        return self._origin + k * period

    def _lead(self) -> float:
        """Return the predicted delay of a command behind its instant [s, control time]."""
        expected = max(self._took, default=0.0)
        if expected < _NEGLIGIBLE_DELAY_SHARE * self._period:
            return 0.0
        return min(expected, PLANNING_SHARE * self._period)

    @property
    def may_start(self) -> bool:
        """Whether to plan for a goal as soon as the rotors are at rest, on a new grid.

        The first plan takes longest, so it waits until the pace, and so its time budget, is known.
        """
        return self.starting and self._watch.pace is not None

    def restart(self) -> None:
        """Begin a new grid with the next tick."""
        self._origin = None

    def command_time(self, request: PlanRequest, elapsed: float) -> float:
        """Return the control time [s] now that planning has taken `elapsed` [s, wall].

        A simulated clock shows the same time throughout a callback, while the robot moves. A
        command must not begin long after the clock that is known, whatever pace was measured.
        """
        return request.now + min(elapsed * (self._watch.pace or 0.0), MOST_AHEAD)

    def answer(self, request: PlanRequest) -> FirstOrderHold | None:
        """Return what to send where the controller has committed nothing; None is nothing."""
        return None

    def completed(self, duration: float, solved: bool) -> None:
        """Record a plan that took `duration` from its request to its command [s, wall]."""
        self._took.append(self._late + duration * (self._watch.pace or 1.0))
        self.starting = self.starting and not solved

    def is_overdue(self, age: float, are_ended: bool) -> bool:
        """Return whether to plan though nothing triggers it, as poses do in lockstep.

        `age` is that of the newest pose [s]; `are_ended` whether who publishes them says so.
        """
        return False

    def request(self, now: float) -> PlanRequest:
        """Return a request for control time `now` [s], whatever the grid."""
        return self._request(now, now, 0.0)

    def goal_changed(self) -> None:
        """Prepare for the first plan towards a new goal, or after the controller was enabled."""
        self.starting = True

    def clock_jumped(self, watch: ClockWatch) -> None:
        """Restart after a jump of control time, or on the clock of another `watch`."""
        if watch is not self._watch:
            self._watch = watch
            self._took.clear()
        self.kept = self._origin = None
        self.goal_changed()

    def refusal(self, settings: ControllerSettings) -> str | None:
        """Return why a change to `settings` is impossible while running; None if it is not."""
        return None

    def change(self, settings: ControllerSettings) -> None:
        """Apply new settings; another control period begins a new grid."""
        self._pose_timeout = settings.pose_timeout
        if settings.control_period != self._period:
            self.timer_period = self._period = settings.control_period
            self._took.clear()
            self._origin = None

    def _request(self, instant: float, now: float, lead: float) -> PlanRequest:
        period = self._period
        left = max(instant + PLANNING_SHARE * period - now, _MIN_PLANNING_SHARE * period)
        return PlanRequest(instant + lead, now, left / (self._watch.pace or 1.0))


class LockstepSchedule(Schedule):
    """Scheduler in lockstep: one plan for each pose of a sampling instant, all are answered.

    A plan may take any wall time, so that results are repeatable. Neither a timer nor the clock of
    the node is needed: the stamp of the pose is the time.
    """

    is_real_time = False

    def __init__(self, settings: ControllerSettings, watch: ClockWatch) -> None:
        super().__init__(settings, watch)
        self.timer_period, self.starting = None, False

    def pose_received(self, pose: TimedPose, now: float | None) -> bool:
        """Return whether to observe a pose and to plan for it: that of a sampling instant."""
        if pose.stamp % round(self._period * NANOSECONDS):
            return False
        self.answered = pose.stamp
        return True

    def is_overdue(self, age: float, are_ended: bool) -> bool:
        """Return whether no pose is to be expected of an instant at which the simulator waits.

        Otherwise one may be late, or time has gone on without.
        """
        return are_ended or age > max(self._pose_timeout, self._period)

    def request(self, now: float) -> PlanRequest:
        """Return a request for control time `now` [s], without a limit of time."""
        return PlanRequest(now, now, math.inf)

    def command_time(self, request: PlanRequest, elapsed: float) -> float:
        """Return the instant itself, at which simulated time waits."""
        return request.now

    def answer(self, request: PlanRequest) -> FirstOrderHold:
        """Return rest: the simulator waits for an answer."""
        return _AT_REST.delayed(request.instant)

    def goal_changed(self) -> None:
        """Plan for the present instant again, even if it has been answered."""
        self.answered = None

    def refusal(self, settings: ControllerSettings) -> str | None:
        """Return why another control period is impossible: the simulator waits at fixed ones."""
        if settings.control_period == self._period:
            return None
        return (
            f"strategy: given '{settings.strategy}' in lockstep, expected one that samples every "
            f"{self._period:g} s, as the simulator waits for"
        )
