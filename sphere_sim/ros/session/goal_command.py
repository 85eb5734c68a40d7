# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Command ``goal``: send goals or a path, and print whether they are in force, or reached."""

import math
import sys
from collections.abc import Callable, Sequence

import rclpy

from sphere_nmpc.control.goal_client import NavigatorSettings, Outcome
from sphere_nmpc.control.goal_report import GoalReport
from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.startup import start_ros, without_ros_arguments
from sphere_sim.recording.message_fields import number, reported_orientation
from sphere_sim.ros.session.goal_arguments import GoalRequest, parse
from sphere_sim.ros.session.goal_sender import GoalNotAcceptedError, GoalSender
from sphere_sim.ros.session.serving import serve_until

_ANSWER_TIMEOUT = 5.0
"""Longest wait for the confirmation of the controller, and for its decision after that [s]."""
SETTINGS = NavigatorSettings(controller_timeout=10.0)
"""Patience of ``--wait``: launch starts a controller anew in about 5 s with ``respawn:=true``, and
it continues to its goals."""


class NotReachedError(SphereNmpcError):
    """The goals are not reached, or not pursued any more."""


def main(args: Sequence[str] | None = None) -> int:
    """Send the goals; return 0 when they are in force, or are reached with ``--wait``, or 1."""
    given = list(sys.argv[1:] if args is None else args)
    request = parse(without_ros_arguments(given))
    start_ros(given)
    node = GuardedNode("goal")

    def spin() -> None:
        rclpy.spin_once(node, timeout_sec=0.05)

    sender = GoalSender(node, spin, SETTINGS, type(request.message))
    try:
        print(f"{request}: {_outcome(request, sender)}")
    except (GoalNotAcceptedError, NotReachedError) as error:
        print(f"{request}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{request}: {_end(request, sender)}", file=sys.stderr)
        return 1
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _outcome(request: GoalRequest, sender: GoalSender) -> str:
    """Send the goals and wait for what is requested; return what has come of them."""
    sender.wait_for_controller(
        request.timeout, lambda line: print(f"{request}: {line}", file=sys.stderr, flush=True)
    )
    sender.send(request.message, _ANSWER_TIMEOUT, until_taken=not request.wait)
    if request.wait:
        # Only here, as the display needs another package.
        from sphere_sim.ros.session.goal_display import GoalDisplay

        with GoalDisplay() as display:
            took = _wait(sender, display.update)
        off = display.largest_deviation
        path = f", at most {1e3 * off:.2g} mm off the path" if math.isfinite(off) else ""
        return f"reached after {took:.2f} s{_error(sender)}{path}"
    # The newest decision may be one of before the goal.
    serve_until(sender.spin, lambda: sender.report.mode != Kind.NO_GOAL.value, _ANSWER_TIMEOUT)
    if obstacle := sender.obstacle():
        return f"in force, but the controller waits: {obstacle}"
    return f"in force; {sender.subscription.topic_name} reports the progress"


def _wait(sender: GoalSender, show: Callable[[GoalReport], object]) -> float:
    """Wait for the end of the goals, and return the control time that took [s].

    `show` takes each report. `NotReachedError` has the reason for another end than the arrival.
    """
    elapsed, report = 0.0, sender.report
    while sender.ending is None:
        before, report = report, sender.report
        if report is not before:
            # A controller that was started anew may count from its own start.
            elapsed += max(0.0, report.time - before.time)
            show(report)
        sender.spin()
    show(sender.report)
    if sender.ending.outcome is Outcome.SUCCEEDED:
        return elapsed + max(0.0, sender.report.time - report.time)
    if sender.ending.missed:
        reason = sender.obstacle() or sender.ending.reason
        raise NotReachedError(f"the controller does not pursue it: {reason}")
    raise NotReachedError(sender.ending.reason)


def _error(sender: GoalSender) -> str:
    """Return the errors at the arrival of what the goal demands."""
    values = {"mm": 1e3 * number(sender.values, "position_error_m")}
    if reported_orientation(sender.values) is not Orientation.ANY:
        values["deg"] = math.degrees(number(sender.values, "angle_error_rad"))
    known = [f"{value:.2g} {unit}" for unit, value in values.items() if math.isfinite(value)]
    return f", error {', '.join(known)}" if known else ""


def _end(request: GoalRequest, sender: GoalSender) -> str:
    """Return what becomes of the goals after an interruption."""
    if sender.client.goal is None:
        return "interrupted before it was sent"
    if not request.cancel_on_interrupt:
        return "interrupted; the sphere goes on to it"
    try:
        sender.client.cancel(sender.client.goal)
        while sender.ending is None:
            sender.spin()
    except KeyboardInterrupt:
        return "interrupted twice, perhaps not cancelled"
    if sender.ending.outcome is Outcome.CANCELED:
        return "interrupted, cancelled; the sphere is at rest on its path"
    return f"interrupted; {sender.ending.reason}"
