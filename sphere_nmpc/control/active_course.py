# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Course in force: where goals come in, it is decided once whether they are the same."""

from dataclasses import dataclass, replace
from functools import cached_property

from sphere_nmpc.control.goal_motion import GoalMotion, current
from sphere_nmpc.model.course import Course, Leg
from sphere_nmpc.model.goal import Goal


@dataclass(frozen=True, eq=False)
class ActiveCourse:
    """Course with the leg of it that is followed."""

    course: Course
    """The course."""
    stamp: int = 0
    """Stamp of the message that brought it [ns]; 0 if it has come otherwise."""
    index: int = 0
    """Which leg is followed."""

    @cached_property
    def leg(self) -> Leg:
        """The leg that is followed."""
        return self.course.legs[self.index]

    @cached_property
    def goal(self) -> Goal:
        """The goal that is aimed at."""
        return self.course.legs[self.index].goal

    @cached_property
    def is_last(self) -> bool:
        """Whether no other leg follows."""
        return self.index == len(self.course.legs) - 1


class CourseInForce:
    """Owner of the course in force, from the goals as they come in."""

    def __init__(self) -> None:
        self.active: ActiveCourse | None = None
        """The course in force, None without goals."""
        self._motion = GoalMotion()

    def take(self, given: ActiveCourse, time: float | None, is_at_its_end: bool) -> bool:
        """Put a course in force; return whether it is another one than before.

        A list or path that is given again goes on, unless it `is_at_its_end`. A single goal that
        is given again and again may differ a little each time, where the control time [s] is known
        for which it is given.
        """
        known, course = self.active, given.course
        if time is not None and len(course.legs) == 1 and course.legs[0].follows is None:
            goal, is_other = self._motion.update(time, given.goal)
            if known is not None and not is_other:
                self.active = replace(given, course=known.course.aimed(0, goal))
                return False
        else:
            self._motion = GoalMotion()
        is_new = known is None or not known.course.is_listed_in(course)
        may_repeat = known is not None and (known.index > 0 or known.leg.follows is not None)
        if known is not None and not (is_new or (may_repeat and is_at_its_end)):
            self.active = replace(known, stamp=given.stamp)
            return False
        self.active = given
        return True

    def clear(self) -> bool:
        """Give up the goals; return whether there were any."""
        known, self.active, self._motion = self.active, None, GoalMotion()
        return known is not None

    def advance(self) -> None:
        """Follow the next leg."""
        if self.active is not None:
            self.active = replace(self.active, index=self.active.index + 1)

    def at(self, time: float) -> ActiveCourse | None:
        """Return the course as it is to be expected from a control time [s] on."""
        known = self.active
        if known is not None:
            goal = current(known.goal, time)
            if goal is not known.goal:
                course = known.course.aimed(known.index, goal)
                known = self.active = replace(known, course=course)
        return known
