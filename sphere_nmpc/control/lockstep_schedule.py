# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scheduler of a controller in lockstep: simulated time waits for each of its commands."""

import math
from collections.abc import Callable

import numpy as np

from sphere_nmpc.control.clock_watch import ClockWatch
from sphere_nmpc.control.schedule import NOTHING, Actions, PlanRequest, TimedPose
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import INPUT_SIZE
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.settings import ControllerSettings

_AT_REST = FirstOrderHold.constant(0.0, np.zeros(INPUT_SIZE))


class LockstepSchedule:
    """Scheduler of one plan for each pose of a sampling instant, all of which are answered.

    A plan may take any wall time, so that results are repeatable. The clock of the node is
    ignored: the stamp of the pose is the time.

    Parameters
    ----------
    settings : ControllerSettings
        Strategy and rates.
    """

    is_real_time = False
    timer_period = None
    """No timer is needed."""
    window = 0.0
    """Without effect: time waits for commands."""
    missed = 0
    """No instant is missed: time waits for it."""

    def __init__(self, settings: ControllerSettings) -> None:
        self._period = settings.control_period
        self._answered: int | None = None

    def pose_age(self, time: float, now: float | None) -> float:
        """Return nan: poses set the time."""
        return math.nan

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

    def tick(self, now: float) -> Actions:
        """Return no action: poses trigger plans."""
        return NOTHING

    def start(
        self, now: float, awaits_start: Callable[[float], bool]
    ) -> Actions | None:
        """Return None: a new goal is planned for when the pose is repeated or the next arrives."""
        return None

    def restart(self, now: float) -> Actions:
        """Return no action: the sampling instants are those at which the simulator waits."""
        return NOTHING

    def command_time(self, request: PlanRequest, elapsed: float) -> float:
        """Return the sampling instant: no control time passes while a plan is made."""
        return request.now

    def command(
        self, request: PlanRequest, hold: FirstOrderHold | None
    ) -> FirstOrderHold | None:
        """Return the hold, or rest where there is none: the simulator waits for an answer."""
        return _AT_REST.delayed(request.instant) if hold is None else hold

    def completed(self, duration: float, solved: bool) -> None:
        """Ignore how long a plan took."""

    def final_request(self, now: float) -> PlanRequest:
        """Return a request for control time `now` [s] without a limit of wall time."""
        return PlanRequest(now, now, math.inf)

    def goal_changed(self) -> None:
        """Plan for the present instant again, even if it has been answered."""
        self._answered = None

    def enabled(self) -> None:
        """Do nothing: the robot moves from the next sampling instant on."""

    def disabled(self, now: float | None) -> Actions:
        """Return no action: the robot stops from the next sampling instant on."""
        return NOTHING

    def clock_jumped(self, watch: ClockWatch) -> None:
        """Plan at the next pose, even at an instant that was answered before the jump."""
        self._answered = None

    def refusal(self, settings: ControllerSettings) -> str | None:
        """Return why another control period is impossible: the simulator waits at fixed ones."""
        if settings.control_period == self._period:
            return None
        return (
            f"strategy: given '{settings.strategy}' in lockstep, expected one that samples every "
            f"{self._period:g} s, as the simulator waits for"
        )

    def change(self, settings: ControllerSettings) -> None:
        """Do nothing: another control period is refused."""
