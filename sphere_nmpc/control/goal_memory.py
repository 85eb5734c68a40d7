# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""File with the goals in force, from which a restarted controller resumes."""

import json
import os
import time
from pathlib import Path

from sphere_nmpc.foreign_file import read_file
from sphere_nmpc.model.goal import Goal, GoalSequence, Orientation
from sphere_nmpc.model.state import as_state
from sphere_nmpc.own_folder import own_folder

_MOST_BYTES = 1_000_000
"""Size of the file: several times that of the longest list of goals."""


class GoalMemory:
    """File that stores the goals, with the time at which they were last in force.

    A controller resumes them only if it starts soon after the end of the last one and on the
    same clock, which must not have been set back: a simulation that starts again has no goals.

    Parameters
    ----------
    path : Path
        The file, in a folder of this user alone, see `own_folder`.
    keep : float
        Time after the end of a controller within which its goals are resumed [s, wall].
    """

    def __init__(self, path: Path, keep: float) -> None:
        self._path = path
        self._keep = keep

    def save(self, goals: GoalSequence | None, stamp: int, simulated: bool) -> None:
        """Write the goals in force at `stamp` [ns]; without any delete the last.

        `simulated` says whether the stamp is of simulated time or of the system clock.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        own_folder(self._path.parent)
        if goals is None:
            self._path.unlink(missing_ok=True)
            return
        # A process that is killed while it writes must leave the old file or the new one intact.
        fresh = self._path.with_suffix(f".{os.getpid()}")
        content = {
            "goals": [[goal.orientation.value, *goal.pose.tolist()] for goal in goals.goals],
            "goal_stamp": goals.stamp, "index": goals.index,
            "stamp": stamp, "simulated": simulated,
        }
        fresh.write_text(json.dumps(content), encoding="ascii")
        fresh.replace(self._path)

    def recall(self, stamp: int, simulated: bool) -> tuple[GoalSequence, float] | None:
        """Return the goals of a controller that ended recently, and the time since [s, wall].

        None if there are none, if it ended too long ago, or if the clock, which now shows `stamp`
        [ns], is another one or has been set back. OSError is raised if the folder may contain
        goals of others.
        """
        own_folder(self._path.parent)
        try:
            age = max(0.0, time.time() - self._path.stat().st_mtime)
            content = json.loads(read_file(self._path, _MOST_BYTES))
            goals = tuple(
                Goal(as_state(pose), Orientation(kind)) for kind, *pose in content["goals"]
            )
            index = max(0, int(content["index"]))
            sequence = GoalSequence(goals, int(content["goal_stamp"]), index)
            then, _ = int(content["stamp"]), sequence.goal
        except (OSError, ValueError, KeyError, IndexError, TypeError, OverflowError):
            return None
        is_same_clock = content.get("simulated") is simulated and then <= stamp
        return (sequence, age) if is_same_clock and age <= self._keep else None
