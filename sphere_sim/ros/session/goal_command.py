# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Command ``goal``: send one goal, and print whether it was accepted and what it waits for."""

import argparse
import math
import sys
from collections.abc import Callable, Sequence

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from sphere_nmpc.control.decision import Mode
from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector, make_state
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.startup import start_ros, without_ros_arguments
from sphere_sim.ros.session.goal_sender import GoalNotAcceptedError, GoalSender
from sphere_sim.ros.session.serving import serve_until
from sphere_sim.scenario.scenarios import PAPER_CASES

_ANSWER_TIMEOUT = 5.0
"""Longest wait for the confirmation of the controller, and for its status after that [s]."""
_ROUNDED = 1.001
"""Largest angle accepted over a turn, which may be given rounded."""
_REMEDIES = {
    Mode.DISABLED.value: ("controller/enable", "true"),
    Mode.CLOCK_STOPPED.value: ("simulator/pause", "false"),
}
"""Service that ends a state of the controller, and what to send to it."""


def parse(arguments: Sequence[str]) -> tuple[Vector, float]:
    """Return the goal state, shape (6,), and how long to wait for a controller [s]."""
    parser = argparse.ArgumentParser(
        prog="goal",
        description="Send a goal to the controller once it is ready. Exits 0 when the controller "
        "has accepted it, 1 when it has not, 2 when the arguments are wrong.",
        epilog="ROS arguments follow --ros-args, for example: --ros-args -r __ns:=/left",
    )
    parser.add_argument("position", nargs="*", type=float, metavar="X Y", help="position [m]")
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--quaternion", nargs=4, type=float, metavar=("W", "X", "Y", "Z"),
        help="orientation, scalar first, body to world (default: 1 0 0 0)",
    )
    how.add_argument(
        "--yaw", type=float, metavar="ANGLE", help="orientation about the vertical [rad]"
    )
    how.add_argument(
        "--case", type=int, choices=sorted(PAPER_CASES), help="goal of a case of the paper"
    )
    parser.add_argument("--degrees", action="store_true", help="--yaw is in degrees")
    parser.add_argument(
        "--timeout", type=float, default=10.0, metavar="S",
        help="how long to wait for a controller [s] (default: %(default)g)",
    )
    given = parser.parse_args(arguments)
    if given.case is not None:
        if given.position:
            parser.error("--case brings its own position")
        return PAPER_CASES[given.case].goal, given.timeout
    if len(given.position) != 2:
        parser.error(f"expected a position X Y [m], given {len(given.position)} numbers")
    quaternion = given.quaternion or (1.0, 0.0, 0.0, 0.0)
    if given.degrees and given.yaw is None:
        parser.error("--degrees: given without --yaw, whose unit it is")
    if given.yaw is not None:
        turn, unit = (360.0, "deg") if given.degrees else (2.0 * math.pi, "rad")
        if abs(given.yaw) > _ROUNDED * turn:
            hint = "" if given.degrees else "; --degrees is for an angle in degrees"
            parser.error(
                f"--yaw: given {given.yaw:g} {unit}, expected {-turn:.4g} to {turn:.4g}{hint}"
            )
        half = math.pi * given.yaw / turn
        quaternion = (math.cos(half), 0.0, 0.0, math.sin(half))
    try:
        return make_state(given.position, quaternion), given.timeout
    except InvalidStateError as error:
        parser.error(str(error))


def main(args: Sequence[str] | None = None) -> int:
    """Send the goal; return 0 when it is in force, whatever the controller waits for, or 1."""
    given = list(sys.argv[1:] if args is None else args)
    goal, timeout = parse(without_ros_arguments(given))
    start_ros(given)
    node = GuardedNode("goal")
    turn = np.degrees(rotation.logarithm(goal[QUATERNION])).round(1) + 0.0
    sent = (
        f"goal x {goal[0]:g} y {goal[1]:g} m, quaternion wxyz {goal[2:].round(4).tolist()}, "
        f"rotation vector {turn.tolist()} deg"
    )

    def spin() -> None:
        rclpy.spin_once(node, timeout_sec=0.05)

    try:
        status, sender = ControllerStatus(node, spin), GoalSender(node, spin)
        sender.wait_for_controller(timeout)
        sender.send(goal, RobotParameters().shell_radius, _ANSWER_TIMEOUT)
        obstacle = status.obstacle(_ANSWER_TIMEOUT)
    except GoalNotAcceptedError as error:
        print(f"{sent}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{sent}: given up", file=sys.stderr)
        return 1
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    if obstacle is None:
        state = f"; no message on {status.topic} within {_ANSWER_TIMEOUT:g} s"
    elif obstacle:
        state = f", but the controller waits: {obstacle}"
    else:
        state = f"; {status.topic} reports the progress"
    print(f"{sent}: in force{state}")
    return 0


class ControllerStatus:
    """Subscriber of the status of the controller in the namespace of a node.

    From it a sender of a goal learns what else is missing.
    """

    def __init__(self, node: Node, spin: Callable[[], object]) -> None:
        self._node = node
        self._spin = spin
        self._newest: DiagnosticStatus | None = None
        self.topic = node.create_subscription(
            DiagnosticStatus, "controller/status", self._take, 1
        ).topic_name
        """Full name of the topic."""

    def obstacle(self, timeout: float) -> str | None:
        """Return what keeps the controller from moving to a goal that it has just accepted.

        It is the reason with the remedy, empty where nothing does; None if there was no status
        within `timeout` [s].
        """
        self._newest = None
        # The newest decision may be one of before the goal.
        if not serve_until(
            self._spin, lambda: self._newest and _mode(self._newest) != Mode.NO_GOAL.value, timeout
        ):
            return None
        return self._reason(self._newest) if self._newest else None

    def _reason(self, status: DiagnosticStatus) -> str:
        words = [Mode.DISABLED.value] if _mode(status) == Mode.DISABLED.value else []
        if status.level != DiagnosticStatus.OK:
            words.append(status.message)
        # Longer than other foreign texts, as the remedy is at the end.
        return "; ".join(self._remedy(word) or f"{word!r:.400}" for word in words)

    def _remedy(self, word: str) -> str:
        if word not in _REMEDIES:
            return ""
        service, data = _REMEDIES[word]
        name = self._node.resolve_service_name(service)
        return f'{word}: ros2 service call {name} std_srvs/srv/SetBool "{{data: {data}}}"'

    def _take(self, status: DiagnosticStatus) -> None:
        self._newest = status


def _mode(status: DiagnosticStatus) -> str:
    return next((pair.value for pair in status.values if pair.key == "mode"), "")
