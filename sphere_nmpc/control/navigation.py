# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals of actions: which one is in force at the controller, and how each of them ends.

The controller is known by its statuses alone, which tell the stamp of the goal in force. A goal is
sent with a stamp of its own, again until a status shows it, and has one end.
"""

from dataclasses import dataclass, field
from enum import Enum

from sphere_nmpc.control.decision import Mode
from sphere_nmpc.quantity import quantity, validate

_AGAIN = 1.0
"""Time [s] after which a goal that no status shows, or a request to cancel, is sent again."""
_KEPT = 100
"""Earlier goals whose stamps are known."""
_WITHOUT_POSE = {
    mode.value for mode in (
        Mode.NO_CLOCK, Mode.CLOCK_STOPPED, Mode.CLOCK_JUMPED, Mode.NO_POSE, Mode.NO_FRESH_POSE,
    )
}
"""Modes in which the controller cannot do anything about its goal."""


@dataclass(frozen=True)
class NavigatorSettings:
    """Settings of the navigator."""

    controller_timeout: float = quantity(
        5.0, "s",
        "Wall time after which a goal is aborted that no status of the controller shows any more",
        minimum=1.0, maximum=3600.0,
    )
    no_pose_timeout: float = quantity(
        30.0, "s",
        "Wall time after which a goal is aborted while the controller has no fresh poses or its "
        "clock stands still",
        minimum=1.0, maximum=1e6,
    )

    def __post_init__(self) -> None:
        validate(self)


class Outcome(Enum):
    """End of a goal, as actions have it."""

    SUCCEEDED = "succeeded"
    CANCELED = "canceled"
    ABORTED = "aborted"


@dataclass(frozen=True)
class GoalReport:
    """What a status of the controller says about its goals.

    Attributes
    ----------
    stamp : str
        Stamp of the message that brought the goals in force; empty without any.
    index : int
        Which of them is aimed at, from 0 on.
    mode : str
        Value of the controller's `Mode`.
    at_rest : bool
        Whether no rotor moves any more.
    plans : int
        Number of new plans since the controller was started.
    time_left, distance_left : float
        Time [s] and path [m] to the goal aimed at; nan where they are not known.
    """

    stamp: str
    index: int
    mode: str
    at_rest: bool
    plans: int
    time_left: float
    distance_left: float


@dataclass(frozen=True)
class Ending:
    """End of a goal, with the reason in a line."""

    goal: bytes
    outcome: Outcome
    reason: str


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
    stamp: str
    began_at: float
    shown_at: float
    """When a status has last shown it; before the first one, when it began."""
    is_confirmed: bool = False
    """Whether a status has shown it."""
    sent_at: float | None = None
    cancelled_at: float | None = None
    plans: int = 0
    replans: int = 0
    newest: GoalReport | None = field(default=None, repr=False)


class Navigation:
    """The goal in force, which the newest one is, and the end of each goal.

    Times are those of a steady clock [s, wall]; `update` is to be called at intervals.
    """

    def __init__(self, settings: NavigatorSettings) -> None:
        self._settings = settings
        self._pursuit: _Pursuit | None = None
        self._report: GoalReport | None = None
        self._heard_at = float("-inf")
        self._without_pose_since: float | None = None
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
    def replans(self) -> int:
        """Number of new plans since the controller took the goal."""
        return 0 if self._pursuit is None else self._pursuit.replans

    def begin(self, goal: bytes, stamp: str, now: float) -> Requests:
        """Put a goal in force, in the place of the one before; `stamp` must be its own."""
        ended = self._end(Outcome.ABORTED, "a newer goal has taken over")
        self._pursuit = _Pursuit(goal, stamp, began_at=now, shown_at=now)
        return Requests(ended, send=self._may_send(now))

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
        if report.mode not in _WITHOUT_POSE:
            self._without_pose_since = None
        elif self._without_pose_since is None:
            self._without_pose_since = now
        pursuit = self._pursuit
        if pursuit is not None and report.stamp == pursuit.stamp:
            if pursuit.newest is not None:
                # Of a restarted controller the number begins again at 0.
                pursuit.replans += max(0, report.plans - pursuit.plans)
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
        if self._without_pose_since is not None:
            longest = self._settings.no_pose_timeout
            if now - max(self._without_pose_since, pursuit.began_at) > longest:
                return Outcome.ABORTED, f"{report.mode}, for {longest:g} s"
        if pursuit.cancelled_at is not None:
            return self._ending_of_cancelled(pursuit, report, now)
        if report.stamp == pursuit.stamp:
            is_there = report.mode == Mode.AT_GOAL.value
            return (Outcome.SUCCEEDED, "at the goal") if is_there else None
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
        if is_under_way or not is_known or self._shows_own():
            return None
        if report.stamp:
            return Outcome.ABORTED, "another goal has taken over"
        return (Outcome.CANCELED, "at rest") if report.at_rest else None

    def _end(self, outcome: Outcome, reason: str) -> tuple[Ending, ...]:
        """End the goal in force, if there is one."""
        pursuit, self._pursuit = self._pursuit, None
        if pursuit is None:
            return ()
        self._former[pursuit.stamp] = outcome is Outcome.SUCCEEDED
        if len(self._former) > _KEPT:
            del self._former[next(iter(self._former))]
        return (Ending(pursuit.goal, outcome, reason),)

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
