# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""File with the goals in force, from which a restarted controller resumes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sphere_nmpc.model.goal import Goal, GoalSequence, Orientation
from sphere_nmpc.model.state import as_state
from sphere_nmpc.own_folder import KeptFile


def goal_memory(path: Path, keep: float) -> KeptFile[GoalSequence]:
    """Return the file that stores the goals, with the time at which they were last in force.

    They are resumed within the time `keep` [s, wall].
    """
    return KeptFile(path, keep, _content, _goals)


def _content(goals: GoalSequence) -> Mapping[str, Any]:
    return {
        "goals": [[goal.orientation.value, *goal.pose.tolist()] for goal in goals.goals],
        "goal_stamp": goals.stamp, "index": goals.index,
    }


def _goals(content: Any) -> GoalSequence:
    goals = tuple(Goal(as_state(pose), Orientation(kind)) for kind, *pose in content["goals"])
    index = max(0, int(content["index"]))
    sequence = GoalSequence(goals, int(content["goal_stamp"]), index)
    _ = sequence.goal  # an IndexError without it
    return sequence
