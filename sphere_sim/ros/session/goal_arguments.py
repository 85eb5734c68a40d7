# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Arguments of the command ``goal``."""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.foreign.file import InvalidFileError, find_file
from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import QUATERNION, Vector, make_state
from sphere_nmpc.quantities import counted
from sphere_nmpc.ros.goal_link import GoalMessage
from sphere_nmpc.ros.messages import MOST_PLACES
from sphere_sim.output.arguments import finite, not_negative
from sphere_sim.ros.session.goal_messages import (
    goals_message,
    path_message,
    point_message,
    pose_message,
)
from sphere_sim.scenario.csv_file import ScenarioFileError, read_places
from sphere_sim.scenario.scenarios import PAPER_CASES

_ROUNDED = 1.001
"""Largest angle accepted over a turn, which may be given rounded."""
_UPRIGHT = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class GoalRequest:
    """What to send, and what to wait for.

    It has the goals in order, each of shape (6,), of which a `point` has only a position, or the
    places of a path to the only one, shape (P, 2) [m]; the longest wait for a controller [s];
    whether to wait for the arrival, and to cancel when that is interrupted.
    """

    goals: tuple[Vector, ...]
    point: bool = False
    timeout: float = 10.0
    wait: bool = False
    cancel_on_interrupt: bool = False
    places: Vector | None = None

    @cached_property
    def message(self) -> GoalMessage:
        """The message to send."""
        if self.places is not None:
            return path_message(self.places)
        if len(self.goals) > 1:
            return goals_message(self.goals)
        return (point_message if self.point else pose_message)(self.goals[0])

    def __str__(self) -> str:
        goal = self.goals[-1]
        text = f"goal x {goal[0]:g} y {goal[1]:g} m"
        if self.places is not None:
            return f"path of {counted(len(self.places), 'place')} to x {goal[0]:g} y {goal[1]:g} m"
        if self.point:
            return f"{text}, any orientation"
        if len(self.goals) > 1:
            text = f"{len(self.goals)} goals, the last one x {goal[0]:g} y {goal[1]:g} m"
        turn = np.degrees(rotation.logarithm(goal[QUATERNION])).round(1) + 0.0
        return (
            f"{text}, quaternion wxyz {goal[2:].round(4).tolist()}, "
            f"rotation vector {turn.tolist()} deg"
        )


def parse(arguments: Sequence[str]) -> GoalRequest:
    """Return the request of a command line; exits with 2 if the arguments are wrong."""
    parser = _parser()
    given = parser.parse_args(arguments)
    if given.cancel_on_interrupt and not given.wait:
        parser.error("--cancel-on-interrupt: given without --wait, which it ends")
    if given.point and (given.then or given.case is not None):
        parser.error(
            "--point: given with further goals, expected one position X Y; for several goals of "
            "any orientation set goal_orientation of the controller"
        )
    if given.degrees and given.yaw is None and not any(len(goal) == 3 for goal in given.then):
        parser.error("--degrees: given without --yaw, whose unit it is")
    places = None
    try:
        if given.path is not None:
            if given.then or given.position:
                parser.error("--path: given with goals, expected all places in the file")
            places = read_places(find_file(given.path), 2 * MOST_PLACES)
            goals = [make_state(places[-1], _UPRIGHT)]
        else:
            goals = [_first(parser, given)]
        for numbers in given.then:
            if len(numbers) not in (2, 3):
                found = counted(len(numbers), "number")
                parser.error(f"--then: given {found}, expected X Y or X Y YAW")
            turn = _UPRIGHT
            if len(numbers) == 3:
                turn = _about_vertical(parser, "--then", numbers[2], given.degrees)
            goals.append(make_state(numbers[:2], turn))
    except (InvalidFileError, InvalidStateError, ScenarioFileError) as error:
        parser.error(str(error))
    return GoalRequest(
        tuple(goals), given.point or places is not None, given.timeout, given.wait,
        given.cancel_on_interrupt, places,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="sphere_nmpc goal",
        description="Send a goal to the controller once it is ready. Exits 0 when the controller "
        "has accepted it, with --wait when the sphere has arrived, 1 when not, 2 when the "
        "arguments are wrong.",
        epilog="ROS arguments follow --ros-args, for example: --ros-args -r __ns:=/left",
    )
    parser.add_argument("position", nargs="*", type=finite, metavar="X Y", help="position [m]")
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--quaternion", nargs=4, type=finite, metavar=("W", "X", "Y", "Z"),
        help="orientation, scalar first, body to world (default: 1 0 0 0)",
    )
    how.add_argument(
        "--yaw", type=finite, metavar="ANGLE", help="orientation about the vertical [rad]"
    )
    how.add_argument("--point", action="store_true", help="any orientation at that position")
    how.add_argument(
        "--path", type=Path, metavar="FILE.csv",
        help="path through the places of a file, x,y [m] in a row, whose header may name others",
    )
    how.add_argument(
        "--case", type=int, choices=sorted(PAPER_CASES), help="goal of a case of the paper"
    )
    parser.add_argument(
        "--then", nargs="+", type=finite, action="append", default=[], metavar=("X Y", "YAW"),
        help="another goal after that, upright with an angle about the vertical; may be repeated",
    )
    parser.add_argument("--degrees", action="store_true", help="angles are in degrees")
    parser.add_argument(
        "--timeout", type=not_negative, default=GoalRequest.timeout, metavar="S",
        help="how long to wait for a controller [s] (default: %(default)g)",
    )
    parser.add_argument(
        "--wait", action="store_true", help="wait until the sphere has arrived at the last goal"
    )
    parser.add_argument(
        "--cancel-on-interrupt", action="store_true",
        help="on Ctrl-C cancel the goals and wait until the sphere is at rest; else it goes on",
    )
    return parser


def _first(parser: argparse.ArgumentParser, given: argparse.Namespace) -> Vector:
    """Return the first goal, shape (6,)."""
    if given.case is not None:
        if given.position:
            parser.error("--case brings its own position")
        return PAPER_CASES[given.case].goal
    if len(given.position) != 2:
        found = counted(len(given.position), "number")
        parser.error(f"given {found}, expected a position X Y [m]")
    if given.yaw is not None:
        turn = _about_vertical(parser, "--yaw", given.yaw, given.degrees)
        return make_state(given.position, turn)
    return make_state(given.position, given.quaternion or _UPRIGHT)


def _about_vertical(
    parser: argparse.ArgumentParser, option: str, angle: float, degrees: bool
) -> tuple[float, float, float, float]:
    """Return the quaternion wxyz of a turn about the vertical by an angle of an option."""
    turn, unit = (360.0, "deg") if degrees else (2.0 * math.pi, "rad")
    if abs(angle) > _ROUNDED * turn:
        hint = "" if degrees else "; --degrees is for an angle in degrees"
        parser.error(f"{option}: given {angle:g} {unit}, expected {-turn:.4g} to {turn:.4g}{hint}")
    half = math.pi * angle / turn
    return math.cos(half), 0.0, 0.0, math.sin(half)
