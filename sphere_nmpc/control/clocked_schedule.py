# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scheduler of a controller in real time: a timer triggers plans, and time advances meanwhile."""

import math
from collections.abc import Callable

from sphere_nmpc.control.clock_watch import ClockWatch
from sphere_nmpc.control.planning_time import PlanningTime
from sphere_nmpc.control.sample_grid import SampleGrid
from sphere_nmpc.control.schedule import NOTHING, Actions, PlanRequest, TimedPose
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.settings import ControllerSettings


class ClockedSchedule:
    """Scheduler of a plan at each instant of a sample grid, within a share of the control period.

    A plan is made for the instant at which its command will be ready, predicted from recent
    durations. The first plan towards a goal does not wait for the next instant: it begins a new
    grid.

    Parameters
    ----------
    settings : ControllerSettings
        Strategy, rates, and how far a pose may be ahead of the clock (``pose_timeout``).
    watch : ClockWatch
        Pace of control time.
    """

    is_real_time = True

    def __init__(self, settings: ControllerSettings, watch: ClockWatch) -> None:
        self._settings = settings
        self._watch = watch
        self._grid = SampleGrid(settings.control_period)
        self._planning = PlanningTime(settings.control_period, watch)
        self._starting = True
        self._late = 0.0
        self._pose_ahead: TimedPose | None = None
        self.window = 0.0
        """Commitment window: delay of commands that plans are made ahead for [s]."""

    @property
    def timer_period(self) -> float:
        """Control time between two calls of `tick` [s]."""
        return self._settings.control_period

    @property
    def missed(self) -> int:
        """Sampling instants that passed without a tick."""
        return self._grid.missed

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
        instant = self._grid.instant(now)
        self._late = now - instant
        request = self._request(instant, now, self._planning.lead + self.window)
        return Actions(refused=refused, observe=pose, plan=request)

    def start(
        self, now: float, awaits_start: Callable[[float], bool]
    ) -> Actions | None:
        """Return the first tick of a new grid if the next plan starts towards a goal.

        The first plan takes longest, so it waits until the pace, and so its time budget, is known.
        """
        if not self._starting or self._watch.pace is None or not awaits_start(now):
            return None
        return self.restart(now)

    def restart(self, now: float) -> Actions:
        """Return the first tick of a new grid."""
        self._grid.reset()
        return self.tick(now)

    def command_time(self, request: PlanRequest, elapsed: float) -> float:
        """Return the control time [s] now that planning has taken `elapsed` [s, wall].

        A simulated clock shows the same time throughout a callback, while the robot moves.
        """
        return self._planning.after(request.now, elapsed)

    def command(
        self, request: PlanRequest, hold: FirstOrderHold | None
    ) -> FirstOrderHold | None:
        """Return the hold as it is: nothing is sent where nothing is committed."""
        return hold

    def completed(self, duration: float, solved: bool) -> None:
        """Record a plan that took `duration` from its request to its command [s, wall]."""
        self._planning.took(duration, self._late)
        self._starting = self._starting and not solved

    def final_request(self, now: float) -> PlanRequest:
        """Return a request for control time `now` [s], whatever the grid."""
        return self._request(now, now, 0.0)

    def goal_changed(self) -> None:
        """Start immediately."""
        self._starting = True

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
            self._planning = PlanningTime(self._settings.control_period, watch)
        self._pose_ahead = None
        self._grid.reset()
        self.goal_changed()

    def refusal(self, settings: ControllerSettings) -> str | None:
        """Return None: every live setting may change."""
        return None

    def change(self, settings: ControllerSettings) -> None:
        """Apply new settings; another control period begins a new grid."""
        period, self._settings = self._settings.control_period, settings
        if settings.control_period != period:
            self._planning = PlanningTime(settings.control_period, self._watch)
            self._grid.reset(settings.control_period)

    def _is_ahead(self, pose: TimedPose, now: float) -> bool:
        return pose.time - now > self._settings.pose_timeout

    def _request(self, instant: float, now: float, lead: float) -> PlanRequest:
        return PlanRequest(instant + lead, now, self._planning.budget(instant, now))
