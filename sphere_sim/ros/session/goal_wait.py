# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Waiting for the arrival at goals that were sent, and for the stop after they are cancelled."""

import math
import time
from collections.abc import Callable

from sphere_nmpc.control.decision import Mode
from sphere_nmpc.errors import SphereNmpcError
from sphere_sim.recording.message_fields import number
from sphere_sim.ros.session.goal_sender import GoalSender, NotCancelledError
from sphere_sim.ros.session.serving import serve_until

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
_STOP_TIMEOUT = 10.0
"""Longest wait for the sphere to be at rest [s]; a stop takes less than 0.5 s of control time."""


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
    elapsed, instant, silent = 0.0, math.nan, 0.0
    # Until the next decision a status may have the new goals with the mode of the ones before.
    sent = number(status.values, "time_s")
    without: float | None = None
    while True:
        began, count = time.monotonic(), status.count
        spin()
        now = time.monotonic()
        if status.count == count:
            # Less, if this process was stopped meanwhile.
            silent += min(now - began, _LONGEST_SPIN)
            if silent > SILENCE:
                raise NotReachedError(
                    f"no message on {status.topic} for {SILENCE:g} s: the controller is gone"
                )
            continue
        silent, before, instant = 0.0, instant, number(status.values, "time_s")
        # A controller that was started anew may count from its own start.
        elapsed += max(0.0, instant - before)
        show()
        if not status.progress.stamp:
            without = now if without is None else without
            if now > without + _WITHOUT_GOAL:
                raise NotReachedError(
                    "no goal is in force any more: cancelled, or the controller was started anew"
                )
            continue
        without = None
        if not sender.is_in_force:
            raise NotReachedError("another goal took over")
        if status.mode == Mode.DISABLED.value:
            raise NotReachedError(f"the controller does not pursue it: {status.obstacle()}")
        if status.mode == Mode.AT_GOAL.value and instant != sent:
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

    def is_at_rest() -> bool:
        return not status.progress.stamp and status.values.get("at_rest") == "true"

    if serve_until(spin, is_at_rest, _STOP_TIMEOUT):
        return "cancelled; the sphere is at rest on its path"
    return f"cancelled; the sphere is not at rest after {_STOP_TIMEOUT:g} s, {status.mode!r:.100}"
