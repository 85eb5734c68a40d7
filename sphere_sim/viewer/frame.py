# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is shown at one moment, wherever it comes from, and what a user may ask for."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, STATE_SIZE, Vector

DEFAULT_RADIUS = RobotParameters().shell_radius


def _unknown() -> Vector:
    return np.full(INPUT_SIZE, np.nan)


def _nothing() -> Vector:
    return np.empty((0, STATE_SIZE))


@dataclass(frozen=True)
class Offers:
    """What the source of the frames can do for the user.

    Attributes
    ----------
    goal, pause, reset, push : bool
        Whether it takes these requests.
    paused : bool
        Whether time stands still.
    speed : float or None
        Time shown over wall time that was asked for; None where it cannot be asked for.
    strategies : tuple of str
        What the controller can be told to solve; empty where it cannot be told.
    duration : float or None
        Length of a recording [s]; None for what is live.
    """

    goal: bool = False
    pause: bool = False
    reset: bool = False
    push: bool = False
    paused: bool = False
    speed: float | None = None
    strategies: tuple[str, ...] = ()
    duration: float | None = None


@dataclass(frozen=True, eq=False)
class Frame:
    """One moment of one robot; what is not known is None, nan or empty.

    Attributes
    ----------
    time : float
        Time of the state on the robot's clock [s].
    state : ndarray of shape (6,), or None
        Where the sphere is.
    radius : float
        Of the shell [m].
    rotor_speeds, rotor_torques : ndarray, shape (2,)
        [rad/s], [N m].
    goal : ndarray of shape (6,), or None
        The goal in force.
    plan : ndarray, shape (n, 6)
        Predicted states.
    solve_time : float
        Of the newest solve [s].
    cost : float
        Value of the optimal control problem, where that is not a time.
    to_go : float
        In what time the plan reaches the goal [s].
    strategy, mode : str
        What the controller solves, and what it is doing.
    alerts : tuple of str
        What is amiss.
    news : tuple of str
        What to tell the user once, such as why a request was refused.
    fresh : bool
        Whether this is another run than what was shown before, which is to be wiped away.
    offers : Offers
        What may be asked for.
    """

    time: float = 0.0
    state: Vector | None = None
    radius: float = DEFAULT_RADIUS
    rotor_speeds: Vector = field(default_factory=_unknown)
    rotor_torques: Vector = field(default_factory=_unknown)
    goal: Vector | None = None
    plan: Vector = field(default_factory=_nothing)
    solve_time: float = float("nan")
    cost: float = float("nan")
    to_go: float = float("nan")
    strategy: str = ""
    mode: str = ""
    alerts: tuple[str, ...] = ()
    news: tuple[str, ...] = ()
    fresh: bool = False
    offers: Offers = field(default_factory=Offers)


@dataclass(frozen=True, eq=False)
class SetGoal:
    """Ask for a goal, shape (6,)."""

    goal: Vector


@dataclass(frozen=True)
class Pause:
    """Let time stand still, or go on."""

    paused: bool


@dataclass(frozen=True)
class Reset:
    """Back to the start."""


@dataclass(frozen=True)
class Push:
    """Push the sphere."""


@dataclass(frozen=True)
class SetSpeed:
    """Ask for a ratio of time shown over wall time."""

    factor: float


@dataclass(frozen=True)
class SetStrategy:
    """Ask the controller to solve something else."""

    name: str


@dataclass(frozen=True)
class Seek:
    """Go to a moment of a recording [s]."""

    time: float


Request = SetGoal | Pause | Reset | Push | SetSpeed | SetStrategy | Seek


class Source(Protocol):
    """Where frames come from: topics or a bag."""

    def frames(self) -> Sequence[Frame]:
        """Return what is new since the last call, at least one frame; the last one is shown."""

    def handle(self, request: Request) -> str:
        """Do what the user asks for, without waiting; return what to tell the user, if anything.

        Requests that are not among the offers change nothing.
        """
