# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals of actions: which one is in force at the controller, and how each of them ends.

The controller is known by its statuses alone, which tell the stamp of the goal in force. A goal is
one message, or several that are sent one after the other: its stages. Each is sent with a stamp of
its own, again until a status shows it. A goal has one end.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum

from sphere_nmpc.conditions import Kind
from sphere_nmpc.control.goal_report import OF_THE_WAY, GoalReport, Patience
from sphere_nmpc.quantity import quantity, validate

_AGAIN = 1.0
"""Time [s] after which a goal that no status shows, or a request to cancel, is sent again."""
_KEPT = 100
"""Earlier goals whose stamps are known."""


@dataclass(frozen=True)
class NavigatorSettings:
    """Settings of the navigator."""

    controller_timeout: float = quantity(
        5.0, "s",
        "Wall time after which a goal is aborted that no status of the controller shows any more",
        minimum=1.0, maximum=3600.0,
    )
    no_progress_timeout: float = quantity(
        30.0, "s",
        "Wall time after which a goal is aborted that the controller does not pursue, as without "
        "fresh poses or progress, or with a clock that stands still; one that cannot be reached "
        "on this floor is aborted as soon as the sphere stands",
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
    """End of a goal, with the reason in a line and the stages that were missed."""

    goal: bytes
    outcome: Outcome
    reason: str
    missed: tuple[Missed, ...] = ()


@dataclass(frozen=True)
class Requests:
    """What has to be done after an event.

    Attributes
    ----------
    ended : tuple of Ending
        Goals that have ended, each of which is told once.
    send : bool
        Whether the goal in force is to be sent; to be confirmed by `Navigation.sent`.
    cancel : bool
        Whether the controller is to be requested to drop its goals; to be confirmed by
        `Navigation.cancel_requested`.
    """

    ended: tuple[Ending, ...] = ()
    send: bool = False
    cancel: bool = False


@dataclass
class _Pursuit:
    """A goal from its acceptance to its end; times are [s, wall]."""

    goal: bytes
    stamps: Iterator[str]
    """Those of the stages that follow."""
    pause: float
    """How long the sphere stays where it has reached a stage [s]."""
    stamp: str
    """That of the present stage, with which all below is concerned."""
    began_at: float
    shown_at: float
    """When a status has last shown it; before the first one, when it began."""
    patience: Patience
    stage: int = 0
    missed: tuple[Missed, ...] = ()
    """Earlier stages that were missed."""
    is_confirmed: bool = False
    """Whether a status has shown it."""
    sent_at: float | None = None
    reached_at: float | None = None
    cancelled_at: float | None = None
    plans: int = 0
    newest: GoalReport | None = field(default=None, repr=False)


class Navigation:
    """The goal in force, which the newest one is, and the end of each goal.

    A stage that cannot be reached is followed by the next one, and a goal of several succeeds if
    one of them was reached.

    Times are those of a steady clock [s, wall]; `update` is to be called at intervals.
    """

    def __init__(self, settings: NavigatorSettings) -> None:
        self._settings = settings
        self._pursuit: _Pursuit | None = None
        self._report: GoalReport | None = None
        self._heard_at = float("-inf")
        self._former: dict[str, bool] = {}
        """Whether the sphere may stay at earlier goals, by their stamps."""
        self._requested_at: float | None = None
        """When the controller was requested to drop its goals, until it has answered."""
        self._answered_at = float("-inf")

    @property
    def goal(self) -> bytes | None:
        """The goal that has not ended, None without one."""
        return None if self._pursuit is None else self._pursuit.goal

    @property
    def report(self) -> GoalReport | None:
        """What the newest status that showed the goal said about it; None before the first."""
        return None if self._pursuit is None else self._pursuit.newest

    @property
    def stage(self) -> int:
        """The stage of the goal, from 0 on."""
        return 0 if self._pursuit is None else self._pursuit.stage

    def hears_controller(self, now: float) -> bool:
        """Return whether a status has come within the time-out for that."""
        return now - self._heard_at < self._settings.controller_timeout

    def begin(
        self, goal: bytes, stamps: Iterator[str], now: float, pause: float = 0.0
    ) -> Requests:
        """Put a goal in force, in the place of the one before.

        Parameters
        ----------
        goal : bytes
            Its id.
        stamps : iterator of str
            A stamp for each stage, which no other message has; taken when that one is to be sent.
        now : float
            Time [s].
        pause : float
            How long the sphere stays at each stage [s].
        """
        ended = self._end(Outcome.ABORTED, "a newer goal has taken over")
        self._begin_stage(goal, stamps, next(stamps), now, pause)
        return Requests(ended, send=self._may_send(now))

    def _begin_stage(
        self, goal: bytes, stamps: Iterator[str], stamp: str, now: float, pause: float,
        stage: int = 0, missed: tuple[Missed, ...] = (),
    ) -> None:
        patience = Patience(self._settings.no_progress_timeout)
        self._pursuit = _Pursuit(goal, stamps, pause, stamp, now, now, patience, stage, missed)

    def cancel(self, goal: bytes, now: float) -> bool:
        """Cancel a goal, which ends at rest; return False if it has ended already."""
        if self._pursuit is None or self._pursuit.goal != goal:
            return False
        if self._pursuit.cancelled_at is None:
            self._pursuit.cancelled_at = now
        return True

    def abandon(self, reason: str) -> Requests:
        """Abort the goal, and have the controller drop it."""
        ended = self._end(Outcome.ABORTED, reason)
        return Requests(ended, cancel=bool(ended))

    def sent(self, now: float) -> None:
        """Note that the goal in force was sent."""
        if self._pursuit is not None:
            self._pursuit.sent_at = now

    def cancel_requested(self, now: float) -> None:
        """Note that the controller was requested to drop its goals."""
        self._requested_at = now

    def cancel_answered(self, now: float) -> None:
        """Note that the controller has answered that request."""
        self._requested_at, self._answered_at = None, now

    def receive(self, report: GoalReport, now: float) -> Requests:
        """Take a status of the controller."""
        self._report, self._heard_at = report, now
        pursuit = self._pursuit
        if pursuit is not None and report.stamp == pursuit.stamp:
            pursuit.plans, pursuit.newest = report.plans, report
            pursuit.shown_at, pursuit.is_confirmed = now, True
        return self.update(now)

    def update(self, now: float) -> Requests:
        """Return what has to be done by the time `now`."""
        pursuit = self._pursuit
        if pursuit is None:
            # A goal that is followed after its end, as by a controller that was started again.
            return Requests(cancel=self._shows_own(abandoned=True) and self._may_cancel(now))
        ending = self._ending(pursuit, now)
        if ending is not None:
            return Requests(self._end(*ending))
        if self._is_over(pursuit, now):
            return self._go_on(pursuit, now)
        if pursuit.cancelled_at is not None:
            return Requests(cancel=self._shows_own() and self._may_cancel(now))
        lost = pursuit.sent_at is None or (
            max(pursuit.sent_at, pursuit.shown_at) + _AGAIN < now
            and (not pursuit.is_confirmed or self._shows_former())
        )
        return Requests(send=lost and self._may_send(now))

    def _ending(self, pursuit: _Pursuit, now: float) -> tuple[Outcome, str] | None:
        """Return how the goal ends and why, None while it goes on."""
        limit, report = self._settings.controller_timeout, self._report
        if now - max(self._heard_at, pursuit.began_at) > limit:
            return Outcome.ABORTED, f"no status of the controller for {limit:g} s"
        if report is None or self._heard_at < pursuit.began_at:
            return None
        if pursuit.cancelled_at is not None:
            return self._ending_of_cancelled(pursuit, report, now)
        if report.stamp == pursuit.stamp:
            return None
        if pursuit.is_confirmed and not self._shows_former():
            if report.stamp:
                return Outcome.ABORTED, "another goal has taken over"
            if report.plans >= max(pursuit.plans, 1):  # not started again meanwhile
                return Outcome.ABORTED, "cancelled at the controller"
        if now - pursuit.shown_at > limit:
            verb = "follows it no longer" if pursuit.is_confirmed else "has not taken it"
            return Outcome.ABORTED, f"the controller {verb}, for {limit:g} s; its log says more"
        return None

    def _ending_of_cancelled(
        self, pursuit: _Pursuit, report: GoalReport, now: float
    ) -> tuple[Outcome, str] | None:
        # A busy controller may take it late, and would move then.
        is_under_way = (
            not pursuit.is_confirmed and pursuit.sent_at is not None
            and now - pursuit.sent_at < self._settings.controller_timeout
        )
        is_known = pursuit.cancelled_at is not None and self._heard_at > pursuit.cancelled_at
        if is_known and not is_under_way and not self._shows_own():
            if report.stamp:
                return Outcome.ABORTED, "another goal has taken over"
            if report.at_rest:
                return Outcome.CANCELED, "at rest"
        longest = self._settings.no_progress_timeout
        if pursuit.cancelled_at is not None and now - pursuit.cancelled_at > longest:
            return Outcome.ABORTED, f"{report.mode}, for {longest:g} s"
        return None

    def _is_over(self, pursuit: _Pursuit, now: float) -> bool:
        """Return whether the stage has been reached and the pause is over, or it is missed."""
        report = self._report
        if report is None or report.stamp != pursuit.stamp or pursuit.cancelled_at is not None:
            return False
        if pursuit.reached_at is None and report.mode == Kind.AT_GOAL.value:
            pursuit.reached_at = now
        if pursuit.reached_at is not None:
            return now - pursuit.reached_at >= pursuit.pause
        reason = pursuit.patience.exhausted(report, now)
        if reason:
            pursuit.missed += (Missed(pursuit.stage, report.cause, reason),)
        return bool(reason)

    def _go_on(self, pursuit: _Pursuit, now: float) -> Requests:
        """Begin the next stage, or end the goal after the last one."""
        missed = pursuit.missed
        if pursuit.reached_at is None and missed[-1].cause not in OF_THE_WAY:
            return Requests(self._end(Outcome.ABORTED, missed[-1].reason))  # another is no better
        self._keep(pursuit)
        stamp = next(pursuit.stamps, "")
        if stamp:
            self._begin_stage(
                pursuit.goal, pursuit.stamps, stamp, now, pursuit.pause, pursuit.stage + 1, missed
            )
            return Requests(send=self._may_send(now))
        if len(missed) > pursuit.stage:
            return Requests(self._end(Outcome.ABORTED, missed[-1].reason))
        reason = f"{len(missed)} of {pursuit.stage + 1} missed" if missed else "at the goal"
        return Requests(self._end(Outcome.SUCCEEDED, reason))

    def _end(self, outcome: Outcome, reason: str) -> tuple[Ending, ...]:
        """End the goal in force, if there is one."""
        pursuit, self._pursuit = self._pursuit, None
        if pursuit is None:
            return ()
        self._keep(pursuit)
        return (Ending(pursuit.goal, outcome, reason, pursuit.missed),)

    def _keep(self, pursuit: _Pursuit) -> None:
        """Keep the stamp of a stage that is over."""
        self._former[pursuit.stamp] = pursuit.reached_at is not None
        if len(self._former) > _KEPT:
            del self._former[next(iter(self._former))]

    def _shows_former(self) -> bool:
        """Return whether the newest status shows an earlier goal of an action."""
        return self._report is not None and self._report.stamp in self._former

    def _shows_own(self, abandoned: bool = False) -> bool:
        """Return whether the newest status shows a goal of an action, or one to be dropped."""
        if self._report is None:
            return False
        stamp = self._report.stamp
        if abandoned:
            return self._former.get(stamp) is False
        return self._shows_former() or (
            self._pursuit is not None and stamp == self._pursuit.stamp
        )

    def _may_send(self, now: float) -> bool:
        """Return whether no request is under way that would drop a goal sent now."""
        return self._requested_at is None or now - self._requested_at > _AGAIN

    def _may_cancel(self, now: float) -> bool:
        """Return whether the newest status is recent, and not from before the last answer."""
        is_recent = now - self._heard_at < _AGAIN
        return is_recent and self._heard_at > self._answered_at and self._may_send(now)
