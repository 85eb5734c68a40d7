# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Waiting for the arrival at goals that were sent, and for the stop after they are cancelled."""

import math
import time
from collections.abc import Callable, Iterator

from sphere_nmpc.conditions import Kind
from sphere_nmpc.control.goal_report import GoalReport, Patience
from sphere_nmpc.control.navigation import NavigatorSettings
from sphere_nmpc.errors import SphereNmpcError
from sphere_sim.recording.message_fields import number
from sphere_sim.ros.session.controller_status import ControllerStatus
from sphere_sim.ros.session.goal_sender import GoalSender, NotCancelledError

SILENCE = 10.0
"""Wall time without a status after which the controller is gone [s]; launch starts one anew in
about 5 s with ``respawn:=true``, and it continues to its goals."""
_WITHOUT_GOAL = 2.0
"""Wall time without a goal after which it counts as cancelled [s]; a controller that was started
anew needs up to 0.3 s to take up its goals."""
_LONGEST_SPIN = 1.0
"""Longest time for which a node is served at once [s]."""
_ANSWER_TIMEOUT = 5.0
"""Longest wait for the answer of the service [s]."""


class NotReachedError(SphereNmpcError):
    """The goals are not reached, or not pursued any more."""


def wait_until_reached(
    sender: GoalSender, spin: Callable[[], object], show: Callable[[], object]
) -> float:
    """Wait until the last of the goals that were sent is reached; return the control time [s].

    `spin` serves the node for a moment, and `show` is called after each status. `NotReachedError`
    has the reason for which the goals are not pursued any more.
    """
    status = sender.status
    elapsed, instant = 0.0, math.nan
    # Until the next decision a status may have the new goals with the mode of the ones before.
    sent = number(status.values, "time_s")
    without: float | None = None
    patience = Patience(NavigatorSettings().no_progress_timeout)
    for _ in _new_messages(status, spin):
        before, instant = instant, number(status.values, "time_s")
        # A controller that was started anew may count from its own start.
        elapsed += max(0.0, instant - before)
        show()
        if not status.progress.stamp:
            without = time.monotonic() if without is None else without
            if time.monotonic() > without + _WITHOUT_GOAL:
                raise NotReachedError(
                    "no goal is in force any more: cancelled, or the controller was started anew"
                )
            continue
        without = None
        if not sender.is_in_force:
            raise NotReachedError("another goal took over")
        if reason := patience.exhausted(GoalReport.of(status.values), time.monotonic()):
            told = status.obstacle() or reason
            raise NotReachedError(f"the controller does not pursue it: {told}")
        if status.mode == Kind.AT_GOAL.value and instant != sent:
            break
    return elapsed


def cancel(sender: GoalSender, spin: Callable[[], object]) -> str:
    """Cancel the goals that were sent, and wait for the sphere to be at rest; return what it does.

    Goals that have taken over meanwhile stay in force.
    """
    status = sender.status
    if status.progress.stamp and not sender.is_in_force:
        return "another goal has taken over and stays in force"
    try:
        sender.cancel(_ANSWER_TIMEOUT)
    except NotCancelledError as error:
        return f"perhaps not cancelled: {error}"
    try:
        for _ in _new_messages(status, spin):
            if not status.progress.stamp and status.values.get("at_rest") == "true":
                break
            if status.mode == Kind.CLOCK_STOPPED.value:
                return f"cancelled; the sphere stops when time goes on, {status.obstacle()}"
    except NotReachedError as error:
        return f"cancelled; {error}"
    return "cancelled; the sphere is at rest on its path"


def _new_messages(status: ControllerStatus, spin: Callable[[], object]) -> Iterator[None]:
    """Serve a node, and yield after each status; `NotReachedError` is raised where none comes."""
    silent = 0.0
    while True:
        began, count = time.monotonic(), status.count
        spin()
        if status.count != count:
            silent = 0.0
            yield
            continue
        # Less, if this process was stopped meanwhile.
        silent += min(time.monotonic() - began, _LONGEST_SPIN)
        if silent > SILENCE:
            raise NotReachedError(
                f"no message on {status.topic} for {SILENCE:g} s: the controller is gone"
            )
