# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""File with the goals in force, from which a restarted controller resumes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sphere_nmpc.control.active_course import ActiveCourse
from sphere_nmpc.foreign.own_folder import KeptFile
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.state import as_state


def goal_memory(path: Path, keep: float) -> KeptFile[ActiveCourse]:
    """Return the file that stores the goals, with the time at which they were last in force.

    They are resumed within the time `keep` [s, wall].
    """
    return KeptFile(path, keep, _content, _goals)


def _content(active: ActiveCourse) -> Mapping[str, Any]:
    goals = active.course.goals
    return {
        "goals": [[goal.orientation.value, *goal.pose.tolist()] for goal in goals],
        "goal_stamp": active.stamp, "index": active.index,
    }


def _goals(content: Any) -> ActiveCourse:
    goals = tuple(Goal(as_state(pose), Orientation(kind)) for kind, *pose in content["goals"])
    index = max(0, int(content["index"]))
    active = ActiveCourse(Course.of(*goals), int(content["goal_stamp"]), index)
    _ = active.leg  # an IndexError without it
    return active
