# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Source of frames, each the state of one robot at one instant, and the requests of users."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from sphere_nmpc.control.goal_report import GoalReport
from sphere_nmpc.errors import cut
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, POSE_SIZE, Vector
from sphere_nmpc.quantities import quantities
from sphere_sim.evaluation.metrics import errors_to
from sphere_sim.recording.message_fields import HOLDING, ReportedSolve

_DEFAULT = RobotParameters()
DEFAULT_RADIUS = _DEFAULT.shell_radius
"""Radius of the shell where it is not known [m]."""
LONGEST_TEXT = 300
"""Characters of a text that are shown."""


def _unknown(size: int = INPUT_SIZE) -> Vector:
    return np.full(size, np.nan)


@dataclass(frozen=True)
class Capabilities:
    """Requests that the source of the frames can fulfil.

    It accepts to `pause`, `reset` or `push`, and to `stop` the sphere on its way; `paused` says
    whether time is paused, `speed` is the requested ratio of time shown to wall time, None where
    it cannot be changed, and `duration` the length of a recording [s], None for a live source.
    `strategies` can be selected.
    """

    pause: bool = False
    reset: bool = False
    push: bool = False
    stop: bool = False
    paused: bool = False
    speed: float | None = None
    strategies: tuple[str, ...] = ()
    duration: float | None = None


@dataclass(frozen=True, eq=False)
class Frame:
    """State of one robot at one instant; unknown values are None, nan or empty.

    Texts, which come from messages of others, are cut to `LONGEST_TEXT`.

    Attributes
    ----------
    time : float
        Time of the state on the robot's clock [s].
    state, goal : ndarray of shape (6,), or None, and Goal or None
        State of the sphere, the true one where that is known, and goal in force.
    estimate, estimate_error : ndarray of shape (6,), or None, and of shape (2,)
        Pose that odometry estimates where `state` is the true one, and the newest known error of
        an estimate at its own time, see `estimate_errors`: distance [m] and heading [rad].
    radius, robot : float and RobotParameters
        Radius of the shell [m]; inertia and limits of the rotors, which are the ranges of plots.
    rotor_speeds, rotor_torques : ndarray, shape (2,)
        Rotor speeds [rad/s] and torques [N m].
    plan : ndarray, shape (n, 6)
        Predicted states.
    path : ndarray, shape (n, 2)
        Places of the path that is followed [m].
    floor : Grid or None
        Floor with what is occupied there; None where it is free.
    clearance : float
        Least distance between the sphere on its planned path and what is occupied [m].
    solve_time, to_go, cost : float
        Duration of the newest solve, and time until its plan reaches the goal [s]; value of the
        optimal control problem, unless that is a time.
    progress : GoalReport
        Progress through the goals.
    momentum : ndarray, shape (3,)
        Momentum about the contact point that the controller estimates [N m s; world frame].
    strategy, mode, setup : str
        Strategy and mode of the controller; strategy, robot and plant in words.
    alerts, notices : tuple of str
        Present faults; messages to show once, such as the reason of a refused request.
    restarted : bool
        Whether the frame begins another run, so that the lines of the previous one are deleted.
    """

    time: float = 0.0
    state: Vector | None = None
    radius: float = DEFAULT_RADIUS
    robot: RobotParameters = _DEFAULT
    rotor_speeds: Vector = field(default_factory=_unknown)
    rotor_torques: Vector = field(default_factory=_unknown)
    goal: Goal | None = None
    estimate: Vector | None = None
    estimate_error: Vector = field(default_factory=_unknown)
    plan: Vector = field(default_factory=lambda: np.empty((0, POSE_SIZE)))
    path: Vector = field(default_factory=lambda: np.empty((0, 2)))
    floor: Grid | None = None
    clearance: float = float("nan")
    solve_time: float = float("nan")
    cost: float = float("nan")
    to_go: float = float("nan")
    progress: GoalReport = field(default_factory=GoalReport)
    momentum: Vector = field(default_factory=lambda: _unknown(3))
    strategy: str = ""
    mode: str = ""
    setup: str = ""
    alerts: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()
    restarted: bool = False
    capabilities: Capabilities = Capabilities()

    def __post_init__(self) -> None:
        for name in ("strategy", "mode", "setup"):
            object.__setattr__(self, name, cut(getattr(self, name), LONGEST_TEXT))
        for name in ("alerts", "notices"):
            texts = tuple(cut(text, LONGEST_TEXT) for text in getattr(self, name))
            object.__setattr__(self, name, texts)


def errors_of(frame: Frame) -> tuple[float, float]:
    """Return distance [m] and angle [rad] to the goal, nan where they are unknown or not asked."""
    if frame.state is None or frame.goal is None:
        return float("nan"), float("nan")
    _, distance, angle = errors_to(frame.goal, frame.state[None])[0].tolist()
    return distance, angle


def values_of_solve(solve: ReportedSolve) -> dict[str, Any]:
    """Return the values of a frame that the newest solve gives, by their names."""
    to_go = 0.0 if solve.plan == HOLDING else solve.time_to_go
    return {
        "to_go": to_go,
        # The value of a minimum-time problem is the time to go.
        "cost": solve.cost if math.isnan(to_go) else math.nan,
        "solve_time": solve.duration if solve.duration > 0.0 else math.nan,
    }


def rotor_momentum(robot: RobotParameters) -> float:
    """Return the angular momentum of a rotor at its largest speed [N m s]."""
    return robot.rotor_axial_inertia * robot.max_rotor_speed


def radius_at(height: float) -> float:
    """Return the radius of a sphere whose centre is at this height [m].

    It is `DEFAULT_RADIUS` where no robot has it, as in poses in the plane, whose height is 0.
    """
    about = quantities(RobotParameters)["shell_radius"]
    is_one = (about.minimum or 0.0) <= height <= (about.maximum or math.inf)
    return height if is_one else DEFAULT_RADIUS


@dataclass(frozen=True, eq=False)
class SetGoal:
    """Request for a goal, shape (6,)."""

    goal: Vector


@dataclass(frozen=True)
class SetPoint:
    """Request for a goal at a position (x, y) [m; world frame] with any orientation."""

    position: tuple[float, float]


@dataclass(frozen=True)
class SetPath:
    """Request for a path through places (x, y) [m; world frame]."""

    places: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Enable:
    """Request to go on to the goal, or to stop on the way and keep it."""

    enabled: bool


@dataclass(frozen=True)
class Cancel:
    """Request to stop on the way, without a goal from then on."""


@dataclass(frozen=True)
class Pause:
    """Request to pause time, or to resume it."""

    paused: bool


@dataclass(frozen=True)
class Reset:
    """Request to return to the start."""


@dataclass(frozen=True)
class ApplyPush:
    """Request for a push on the sphere with an impulse (x, y) [N s; world frame]."""

    impulse: tuple[float, float]


@dataclass(frozen=True)
class SetSpeed:
    """Request for a ratio of time shown to wall time."""

    factor: float


@dataclass(frozen=True)
class SetStrategy:
    """Request for another strategy of the controller."""

    name: str


@dataclass(frozen=True)
class Seek:
    """Request for a time of a recording [s]."""

    time: float


Request = (
    SetGoal | SetPoint | SetPath | Enable | Cancel
    | Pause | Reset | ApplyPush | SetSpeed | SetStrategy | Seek
)
"""Request to a source."""


@dataclass(frozen=True)
class ChooseGoal:
    """Request to move the goal on the page to one of `GOAL_PRESETS`."""

    preset: str


@dataclass(frozen=True)
class DragGoal:
    """Step of a drag of the goal on the page; the last one has `ended`."""

    ended: bool


@dataclass(frozen=True)
class SendGoal:
    """Request to send the goal on the page to the source."""


@dataclass(frozen=True)
class FindSphere:
    """Request to point the cameras at the sphere."""


PageRequest = Request | ChooseGoal | DragGoal | SendGoal | FindSphere
"""Request from the page: to the viewer, or to its source."""


class Source(Protocol):
    """Source of frames: live topics or a bag."""

    def frames(self) -> Sequence[Frame]:
        """Return the frames since the last call, at least one; the last one is shown."""

    def handle(self, request: Request) -> str:
        """Start to fulfil a request without waiting; return a message for the user, or "".

        Requests outside of the capabilities have no effect.
        """
