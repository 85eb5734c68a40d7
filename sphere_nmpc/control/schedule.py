# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Contract of the schedulers: when to plan, for which instant, and within which wall time."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from sphere_nmpc.control.clock_watch import ClockWatch
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import ControllerSettings


@dataclass(frozen=True, eq=False)
class TimedPose:
    """A measured state with the time of its measurement.

    Attributes
    ----------
    stamp : int
        Time of measurement on the node's clock [ns].
    time : float
        The same as control time [s].
    state : ndarray, shape (6,)
        [x, y, qw, qx, qy, qz] [m; world frame], body to world.
    """

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


class Schedule(Protocol):
    """Scheduler of plans; its owner reports events to it and carries out the `Actions` returned.

    Control times are seconds on the node's clock.
    """

    is_real_time: bool
    """Whether control time advances while a plan is made."""

    window: float
    """Commitment window: delay of commands for which plans are made further ahead [s]."""

    @property
    def timer_period(self) -> float | None:
        """Control time between two calls of `tick` [s]; None if no timer is needed."""

    @property
    def missed(self) -> int:
        """Sampling instants that passed without a tick."""

    def pose_age(self, time: float, now: float | None) -> float:
        """Return the age at `now` of a pose of control time `time` [s]; nan if irrelevant."""

    def pose_received(self, pose: TimedPose, now: float | None) -> Actions:
        """Return what a pose leads to that arrives at control time `now`, None if unknown."""

    def tick(self, now: float) -> Actions:
        """Return what a tick of the timer at control time `now` leads to."""

    def start(
        self, now: float, awaits_start: Callable[[float], bool]
    ) -> Actions | None:
        """Return what to do to start towards a goal now; None if nothing is to be done yet.

        The timer has to be restarted when there is something to do. `awaits_start` returns
        whether at a control time [s] there is a goal to start for and the rotors are at rest.
        """

    def restart(self, now: float) -> Actions:
        """Return what to do to plan now, whatever the sampling instants so far.

        The timer has to be restarted.
        """

    def command_time(self, request: PlanRequest, elapsed: float) -> float:
        """Return the control time [s] from which the command of a plan applies.

        `elapsed` is the wall time since planning began [s].
        """

    def command(
        self, request: PlanRequest, hold: FirstOrderHold | None
    ) -> FirstOrderHold | None:
        """Return what to send where the controller has committed `hold`, None being nothing."""

    def completed(self, duration: float, solved: bool) -> None:
        """Record a plan that took `duration` from its request to its command [s, wall]."""

    def final_request(self, now: float) -> PlanRequest:
        """Return the request for the last plan of a controller that ends, made immediately."""

    def goal_changed(self) -> None:
        """Prepare for the first plan towards a new goal."""

    def enabled(self) -> None:
        """Prepare for the first plan after the controller was enabled."""

    def disabled(self, now: float | None) -> Actions:
        """Return what to do at control time `now` because the controller was disabled."""

    def clock_jumped(self, watch: ClockWatch) -> None:
        """Restart after a jump of control time, or on another clock.

        Parameters
        ----------
        watch : ClockWatch
            Pace of the clock that is followed now.
        """

    def refusal(self, settings: ControllerSettings) -> str | None:
        """Return why a change to `settings` is impossible while running; None if it is not."""

    def change(self, settings: ControllerSettings) -> None:
        """Apply settings that may change while running."""
