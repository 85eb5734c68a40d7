# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Source of frames, and the requests that users make on the page."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from sphere_nmpc.model.state import Vector
from sphere_sim.viewer.frame import Frame


@dataclass(frozen=True, eq=False)
class SetGoal:
    """Request for a goal, shape (6,)."""

    goal: Vector


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


Request = SetGoal | Pause | Reset | ApplyPush | SetSpeed | SetStrategy | Seek
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
