# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Courses: legs in order, each with the goal at its end and how it ends there.

A course is made once, where goals come in; from then on it is compared by identity.
"""

from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from operator import attrgetter

from numpy.typing import ArrayLike

from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.path import Path
from sphere_nmpc.model.state import as_state, upright_state


class LegEnd(Enum):
    """How a leg ends at its goal."""

    REST = "rest"
    """The sphere comes to rest there."""
    THROUGH = "through"
    """The sphere goes on before it is there; only where that fails does it rest."""


@dataclass(frozen=True, eq=False)
class Leg:
    """Part of a course that ends at one goal.

    Attributes
    ----------
    goal : Goal
        Set of goals, of which one member is to be reached. Of a plan it is that member, as it is
        at the arrival.
    end : LegEnd
        How it ends.
    time_left : float
        Time from its end to that of the leg that it is put in front of [s].
    way_left : float
        Length of the way there [m].
    follows : Path or None
        Path to the goal that the centre follows; None where any way leads there.
    speeds : tuple of float
        Rotor speeds at its end beyond those that hold the momentum [rad/s].
    """

    goal: Goal
    end: LegEnd = LegEnd.REST
    time_left: float = 0.0
    way_left: float = 0.0
    follows: Path | None = None
    speeds: tuple[float, float] = (0.0, 0.0)

    def equals(self, other: "Leg") -> bool:
        """Return whether it leads to the same goal, along the same path if along one."""
        if self.follows is None or other.follows is None:
            return self.follows is other.follows and self.goal.equals(other.goal)
        return self.follows.equals(other.follows)


@dataclass(frozen=True, eq=False)
class Course:
    """Legs in the order in which they are followed.

    Attributes
    ----------
    legs : tuple of Leg
        One or more.
    origin : object
        The same object for a course whose goals have moved since it was made.
    """

    legs: tuple[Leg, ...]
    origin: object = field(default_factory=object, repr=False)

    @classmethod
    def of(cls, *goals: Goal | ArrayLike) -> "Course":
        """Return a new course that comes to rest at each of the goals, or poses, shape (6,).

        Their arrays are frozen. `InvalidStateError` is raised if one is not a finite pose with a
        unit quaternion.
        """
        found = [goal if isinstance(goal, Goal) else Goal(as_state(goal)) for goal in goals]
        for goal in found:
            goal.pose.flags.writeable = goal.rate.flags.writeable = False
        return cls(tuple(map(Leg, found)))

    @classmethod
    def along(cls, *paths: Path, end: Goal | None = None) -> "Course":
        """Return a new course along paths, with any orientation, and to a goal after the last."""
        ends = [upright_state(*path.places[-1].tolist()) for path in paths]
        legs = [
            Leg(Goal(pose, Orientation.ANY), follows=path)
            for pose, path in zip(ends, paths, strict=True)
        ]
        return cls((*legs, *(() if end is None else (Leg(end),))))

    @cached_property
    def paths(self) -> tuple[Path, ...]:
        """The paths that its legs follow."""
        return tuple(filter(None, map(attrgetter("follows"), self.legs)))

    @property
    def goals(self) -> tuple[Goal, ...]:
        """The goals of its legs."""
        return tuple(leg.goal for leg in self.legs)

    def aimed(self, index: int, goal: Goal) -> "Course":
        """Return the same course with another goal at the end of a leg, as when it has moved."""
        legs = self.legs
        leg = replace(legs[index], goal=goal)
        return Course((*legs[:index], leg, *legs[index + 1 :]), self.origin)

    def by_way_of(self, index: int, leg: Leg) -> "Course":
        """Return the same course with a leg put in front of the one with this index."""
        return Course((*self.legs[:index], leg, *self.legs[index:]), self.origin)

    def is_listed_in(self, other: "Course") -> bool:
        """Return whether another course has the same legs in the same order."""
        pairs = zip(self.legs, other.legs, strict=False)
        return len(self.legs) == len(other.legs) and all(a.equals(b) for a, b in pairs)
