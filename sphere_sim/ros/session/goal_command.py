# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Command ``goal``: send goals, and print whether they are in force, or reached."""

import math
import sys
from collections.abc import Callable, Sequence

import rclpy

from sphere_nmpc.conditions import Kind
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.startup import start_ros, without_ros_arguments
from sphere_sim.recording.message_fields import number, reported_orientation
from sphere_sim.ros.session.controller_status import ControllerStatus
from sphere_sim.ros.session.goal_arguments import GoalRequest, parse
from sphere_sim.ros.session.goal_sender import GoalNotAcceptedError, GoalSender
from sphere_sim.ros.session.goal_wait import NotReachedError, cancel, wait_until_reached
from sphere_sim.ros.session.serving import serve_until

_ANSWER_TIMEOUT = 5.0
"""Longest wait for the confirmation of the controller, and for its decision after that [s]."""


def main(args: Sequence[str] | None = None) -> int:
    """Send the goals; return 0 when they are in force, or are reached with ``--wait``, or 1."""
    given = list(sys.argv[1:] if args is None else args)
    request = parse(without_ros_arguments(given))
    start_ros(given)
    node = GuardedNode("goal")

    def spin() -> None:
        rclpy.spin_once(node, timeout_sec=0.05)

    sender = GoalSender(node, spin, type(request.message))
    try:
        print(f"{request}: {_outcome(request, sender, spin)}")
    except (GoalNotAcceptedError, NotReachedError) as error:
        print(f"{request}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{request}: {_end(request, sender, spin)}", file=sys.stderr)
        return 1
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _outcome(request: GoalRequest, sender: GoalSender, spin: Callable[[], object]) -> str:
    """Send the goals and wait for what is requested; return what has come of them."""
    status = sender.status
    sender.wait_for_controller(request.timeout)
    sender.send(request.message, _ANSWER_TIMEOUT)
    if request.wait:
        # Only here, as the display needs another package.
        from sphere_sim.ros.session.goal_display import GoalDisplay

        with GoalDisplay(status) as display:
            took = wait_until_reached(sender, spin, display.update)
        return f"reached after {took:.2f} s{_error(status)}"
    # The newest decision may be one of before the goal.
    serve_until(spin, lambda: status.mode != Kind.NO_GOAL.value, _ANSWER_TIMEOUT)
    if obstacle := status.obstacle():
        return f"in force, but the controller waits: {obstacle}"
    return f"in force; {status.topic} reports the progress"


def _error(status: ControllerStatus) -> str:
    """Return the errors at the arrival of what the goal demands."""
    values = {"mm": 1e3 * number(status.values, "position_error_m")}
    if reported_orientation(status.values) is not Orientation.ANY:
        values["deg"] = math.degrees(number(status.values, "angle_error_rad"))
    known = [f"{value:.2g} {unit}" for unit, value in values.items() if math.isfinite(value)]
    return f", error {', '.join(known)}" if known else ""


def _end(request: GoalRequest, sender: GoalSender, spin: Callable[[], object]) -> str:
    """Return what becomes of the goals after an interruption."""
    if not sender.stamp:
        return "interrupted before it was sent"
    if not request.cancel_on_interrupt:
        return "interrupted; the sphere goes on to it"
    try:
        return f"interrupted, {cancel(sender, spin)}"
    except KeyboardInterrupt:
        return "interrupted twice, perhaps not cancelled"
