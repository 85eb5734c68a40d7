# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Client of goals: which one is in force at the controller, and how each of them ends.

The controller is known by its statuses alone, which have the stamp of the goal in force. A goal is
one message, or several that are sent one after the other: its stages. Each is sent with a stamp of
its own, again until a status shows it. A goal has one end.
"""

import math
import time
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

from sphere_nmpc.control.goal_report import OF_THE_WAY, GoalReport, Patience
from sphere_nmpc.quantities import quantity, stamp_text, validate

_RETRY_TIME = 1.0
"""Time [s] after which a goal that no status shows, or a request to cancel, is sent again; the
longest one that counts between two updates, as the process may have been stopped meanwhile."""
_MAX_EARLIER_GOALS = 100
"""Earlier goals whose stamps are known."""


@dataclass(frozen=True)
class NavigatorSettings:
    """Settings of the navigator: the patience of its client of goals."""

    controller_timeout: float = quantity(
        5.0, "s",
        "Wall time after which a goal is aborted that no status of the controller shows any more",
        minimum=1.0, maximum=3600.0,
    )
    no_progress_timeout: float = quantity(
        30.0, "s",
        "Wall time after which a goal is aborted that the controller does not pursue, as without "
        "fresh poses or progress, or with a clock that stands still; one outside of the floor or "
        "in what is occupied is aborted at once, one without a way as soon as the sphere stands",
        minimum=1.0, maximum=1e6,
    )
    waypoint_pause: float = quantity(
        0.2, "s", "Wall time that the sphere stays at each waypoint of follow_waypoints",
        maximum=1e6,
    )

    def __post_init__(self) -> None:
        validate(self)


class Outcome(Enum):
    """End of a goal, as actions have it."""

    SUCCEEDED = "succeeded"
    CANCELED = "canceled"
    ABORTED = "aborted"


@dataclass(frozen=True)
class Missed:
    """A stage that the controller does not pursue; `cause` is that of a `GoalReport`."""

    stage: int
    cause: str
    reason: str


@dataclass(frozen=True)
class Ending:
    """End of a goal, with the reason in a line, and which stages were missed.

    `passed` is the number of goals that were passed of the last stage that a status has shown.
    """

    goal: Hashable
    outcome: Outcome
    reason: str
    missed: tuple[Missed, ...] = ()
    passed: int = 0


@dataclass(frozen=True)
class Due:
    """What is to be done now."""

    ended: tuple[Ending, ...] = ()
    """Goals that have ended, each of which is reported once."""
    send: bool = False
    """Whether the message of the stage is to be sent, with its stamp."""
    cancel: bool = False
    """Whether the controller is to be requested to drop its goals."""


@dataclass
class Pursuit:
    """A goal from its acceptance to its end; times are those of the client [s]."""

    goal: Hashable
    stages: Iterator[Any]
    """Messages of the stages that follow."""
    pause: float
    """How long the sphere stays where it has reached a stage [s]."""
    until_taken: bool
    """Whether a stage is over when the controller shows it."""
    message: Any
    """Message of the present stage, with which all below is concerned."""
    stamp: int
    """Stamp of the message [ns]."""
    began_at: float
    patience: Patience
    shown_at: float
    """When a status has last shown it; before the first one, when it began."""
    stage: int = 0
    """The present stage, from 0 on."""
    missed: tuple[Missed, ...] = ()
    """Earlier stages that were missed."""
    sent_at: float | None = None
    reached_at: float | None = None
    cancelled_at: float | None = None
    newest: GoalReport | None = field(default=None, repr=False)
    """What the newest status that has shown it says; None before the first."""


class GoalClient:
    """The goal in force, which the newest one is, and the end of each goal.

    A stage that cannot be reached is followed by the next one, and a goal of several succeeds if
    one of them was reached. A goal that has ended without having been reached is dropped where the
    controller turns up with it later, as one does that was started again.

    `begin`, `cancel`, `abandon`, `receive` and `cancel_answered` take what has happened, and
    `update` returns what is due; it is to be called after each of them, and at intervals.

    Parameters
    ----------
    settings : NavigatorSettings
        For how long controller and progress are waited for.
    new_stamp : callable
        Returns a stamp [ns] that no other message has.
    """

    def __init__(
        self, settings: NavigatorSettings, new_stamp: Callable[[], int] = time.time_ns
    ) -> None:
        self._settings, self._new_stamp = settings, new_stamp
        self._now, self._clock = 0.0, math.nan
        """Time of the client, and the time that was given with it [s]."""
        self.pursuit: Pursuit | None = None
        """The goal that has not ended, None without one."""
        self._report: GoalReport | None = None
        self._heard_at = -math.inf
        self._ended: list[Ending] = []
        self._former: dict[str, bool] = {}
        """Whether the sphere may stay at earlier goals, by their stamps."""
        self._requested_at: float | None = None
        """When the controller was requested to drop its goals, until it has answered."""
        self._answered_at = -math.inf

    @property
    def goal(self) -> Hashable | None:
        """Id of the goal that has not ended, None without one."""
        return None if self.pursuit is None else self.pursuit.goal

    @property
    def report(self) -> GoalReport | None:
        """What the newest status that showed the goal said about it; None before the first."""
        return None if self.pursuit is None else self.pursuit.newest

    @property
    def hears_controller(self) -> bool:
        """Whether a status has come within the time-out for that."""
        return self._now - self._heard_at < self._settings.controller_timeout

    def begin(
        self, goal: Hashable, stages: Iterator[Any], pause: float = 0.0, until_taken: bool = False
    ) -> None:
        """Put a goal in force, in the place of the one before.

        Parameters
        ----------
        goal : hashable
            Its id.
        stages : iterator
            Message of each stage, one at least; taken when that one is to be sent.
        pause : float
            How long the sphere stays at each stage [s].
        until_taken : bool
            Whether a stage is left to the controller as soon as a status shows it, rather than
            followed until it is reached.
        """
        self._end(Outcome.ABORTED, "a newer goal has taken over")
        patience = Patience(self._settings.no_progress_timeout)
        self.pursuit = Pursuit(
            goal, stages, pause, until_taken, next(stages), self._new_stamp(), self._now,
            patience, self._now,
        )

    def cancel(self, goal: Hashable) -> bool:
        """Cancel a goal, which ends at rest; return False if it has ended already."""
        if self.pursuit is None or self.pursuit.goal != goal:
            return False
        if self.pursuit.cancelled_at is None:
            self.pursuit.cancelled_at = self._now
        return True

    def abandon(self, reason: str) -> None:
        """Abort the goal; the controller is to drop it."""
        self._end(Outcome.ABORTED, reason)

    def cancel_answered(self) -> None:
        """Note that the controller has answered a request to drop its goals."""
        self._requested_at, self._answered_at = None, self._now

    def receive(self, report: GoalReport, now: float) -> None:
        """Take a status of the controller."""
        self._advance(now)
        self._report, self._heard_at = report, self._now
        pursuit = self.pursuit
        if pursuit is not None and report.stamp == stamp_text(pursuit.stamp):
            pursuit.newest, pursuit.shown_at = report, self._now

    def update(self, now: float, can_send: bool = True, can_cancel: bool = True) -> Due:
        """Return what is due at the time `now` [s] of a steady clock, which counts as done.

        `can_send` and `can_cancel` are whether there is a controller for either.
        """
        self._advance(now)
        pursuit = self.pursuit
        if pursuit is not None and (ending := self._ending(pursuit)) is not None:
            self._end(*ending)
        elif pursuit is not None and self._is_over(pursuit):
            self._go_on(pursuit)
        pursuit, send, cancel = self.pursuit, False, False
        may_act = self._requested_at is None or self._now - self._requested_at > _RETRY_TIME
        if pursuit is None or pursuit.cancelled_at is not None:
            if cancel := can_cancel and may_act and self._is_to_drop():
                self._requested_at = self._now
        # What is sent while a request is under way would be dropped by it.
        elif send := can_send and may_act and self._is_lost(pursuit):
            pursuit.sent_at = self._now
        ended, self._ended = tuple(self._ended), []
        return Due(ended, send, cancel)

    def _advance(self, now: float) -> None:
        """Advance the client's time, in which none passes for a process that is stopped."""
        if not math.isnan(self._clock):
            self._now += min(max(0.0, now - self._clock), _RETRY_TIME)
        self._clock = now

    def _is_lost(self, pursuit: Pursuit) -> bool:
        """Return whether the message of the stage is to be sent, for the first time or again."""
        if pursuit.sent_at is None:
            return True
        is_late = max(pursuit.sent_at, pursuit.shown_at) + _RETRY_TIME < self._now
        return is_late and (pursuit.newest is None or self._shows_former())

    def _is_to_drop(self) -> bool:
        """Return whether the controller follows a goal that is cancelled, or over.

        The status is to be recent, and not from before the last answer.
        """
        is_recent = self._now - self._heard_at < _RETRY_TIME and self._heard_at > self._answered_at
        if self.pursuit is None:  # it may stay where it was reached
            return is_recent and self._former.get(self._shown) is False
        return is_recent and self._shows_own(self.pursuit)

    def _ending(self, pursuit: Pursuit) -> tuple[Outcome, str] | None:
        """Return how the goal ends and why, None while it goes on."""
        limit, report, now = self._settings.controller_timeout, self._report, self._now
        if now - max(self._heard_at, pursuit.began_at) > limit:
            return Outcome.ABORTED, f"no status of the controller for {limit:g} s"
        if report is None or self._heard_at < pursuit.began_at:
            return None
        if pursuit.cancelled_at is not None:
            return self._ending_of_cancelled(pursuit, report, pursuit.cancelled_at)
        if report.stamp == stamp_text(pursuit.stamp):
            return None
        if pursuit.newest is not None and not self._shows_former():
            if report.stamp:
                return Outcome.ABORTED, "another goal has taken over"
            if report.plans >= max(pursuit.newest.plans, 1):  # not started again meanwhile
                return Outcome.ABORTED, "cancelled at the controller"
        if now - pursuit.shown_at > limit:
            verb = "has not taken it" if pursuit.newest is None else "follows it no longer"
            return Outcome.ABORTED, f"the controller {verb}, for {limit:g} s; its log says more"
        return None

    def _ending_of_cancelled(
        self, pursuit: Pursuit, report: GoalReport, cancelled_at: float
    ) -> tuple[Outcome, str] | None:
        # A busy controller may take it late, and would move then.
        is_under_way = (
            pursuit.newest is None and pursuit.sent_at is not None
            and self._now - pursuit.sent_at < self._settings.controller_timeout
        )
        is_known = self._heard_at > cancelled_at
        if is_known and not is_under_way and not self._shows_own(pursuit):
            if report.stamp:
                return Outcome.ABORTED, "another goal has taken over"
            if report.at_rest:
                return Outcome.CANCELED, "at rest"
        longest = self._settings.no_progress_timeout
        if self._now - cancelled_at > longest:
            return Outcome.ABORTED, f"{report.mode}, for {longest:g} s"
        return None

    def _is_over(self, pursuit: Pursuit) -> bool:
        """Return whether the stage has been reached and the pause is over, or it is missed."""
        report = self._report
        if report is None or report is not pursuit.newest or pursuit.cancelled_at is not None:
            return False
        if pursuit.reached_at is None and (pursuit.until_taken or report.is_at_goal):
            pursuit.reached_at = self._now
        if pursuit.reached_at is not None:
            return self._now - pursuit.reached_at >= pursuit.pause
        reason = pursuit.patience.exhausted(report, self._now)
        if reason:
            pursuit.missed += (Missed(pursuit.stage, report.cause, reason),)
        return bool(reason)

    def _go_on(self, pursuit: Pursuit) -> None:
        """Begin the next stage, or end the goal after the last one."""
        missed = pursuit.missed
        if pursuit.reached_at is None and missed[-1].cause not in OF_THE_WAY:
            self._end(Outcome.ABORTED, missed[-1].reason)  # another stage is no better
        elif (message := next(pursuit.stages, None)) is not None:
            self._keep(pursuit)
            self.pursuit = replace(
                pursuit, message=message, stamp=self._new_stamp(), began_at=self._now,
                patience=Patience(self._settings.no_progress_timeout), shown_at=self._now,
                stage=pursuit.stage + 1, sent_at=None, reached_at=None, newest=None,
            )
        elif len(missed) > pursuit.stage:
            self._end(Outcome.ABORTED, missed[-1].reason)
        else:
            of_all = f"{len(missed)} of {pursuit.stage + 1} missed"
            self._end(Outcome.SUCCEEDED, of_all if missed else "at the goal")

    def _end(self, outcome: Outcome, reason: str) -> None:
        """End the goal in force, if there is one."""
        pursuit, self.pursuit = self.pursuit, None
        if pursuit is not None:
            self._keep(pursuit)
            passed = 0 if pursuit.newest is None else pursuit.newest.index
            self._ended.append(Ending(pursuit.goal, outcome, reason, pursuit.missed, passed))

    def _keep(self, pursuit: Pursuit) -> None:
        """Keep the stamp of a stage that is over."""
        self._former[stamp_text(pursuit.stamp)] = pursuit.reached_at is not None
        if len(self._former) > _MAX_EARLIER_GOALS:
            del self._former[next(iter(self._former))]

    @property
    def _shown(self) -> str:
        """Stamp of the goal that the newest status shows; empty without one."""
        return "" if self._report is None else self._report.stamp

    def _shows_former(self) -> bool:
        return self._shown in self._former

    def _shows_own(self, pursuit: Pursuit) -> bool:
        """Return whether the newest status shows a goal of this client."""
        return self._shows_former() or self._shown == stamp_text(pursuit.stamp)
