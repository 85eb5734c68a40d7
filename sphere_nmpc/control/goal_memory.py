# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""File with the goal in force, from which a restarted controller resumes."""

import json
import os
import tempfile
import time
from pathlib import Path

from sphere_nmpc.model.state import Vector, as_state


def cache_folder() -> Path:
    """Return the user's folder for files that are kept between runs; it may not exist yet."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if base.startswith("~"):
        # Neither HOME nor an entry in the list of users, as of a bare user id in a container.
        return Path(tempfile.gettempdir(), f"sphere_nmpc-{os.getuid()}")
    return Path(base, "sphere_nmpc")


class GoalMemory:
    """File that stores the goal, with the time at which it was last in force.

    A controller resumes the goal only if it starts soon after the end of the last one and on the
    same clock, which must not have been set back: a simulation that starts again has no goal.

    Parameters
    ----------
    path : Path
        The file; its folder is made when it is first written.
    keep : float
        Time after the end of a controller within which its goal is resumed [s, wall].
    """

    def __init__(self, path: Path, keep: float) -> None:
        self._path = path
        self._keep = keep

    def save(self, goal: Vector | None, stamp: int, simulated: bool) -> None:
        """Write the goal, shape (6,), in force at `stamp` [ns]; without one delete the last.

        `simulated` says whether the stamp is of simulated time or of the system clock.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        if self._keep <= 0.0:
            return
        if goal is None:
            self._path.unlink(missing_ok=True)
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        # A process that is killed while it writes must leave the old file or the new one intact.
        fresh = self._path.with_suffix(f".{os.getpid()}")
        content = {"goal": goal.tolist(), "stamp": stamp, "simulated": simulated}
        fresh.write_text(json.dumps(content), encoding="ascii")
        fresh.replace(self._path)

    def recall(self, stamp: int, simulated: bool) -> tuple[Vector, float] | None:
        """Return the goal of a controller that ended recently, and the time since [s, wall].

        None if there is none, if it ended too long ago, or if the clock, which now shows `stamp`
        [ns], is another one or has been set back.
        """
        try:
            age = max(0.0, time.time() - self._path.stat().st_mtime)
            content = json.loads(self._path.read_text(encoding="ascii"))
            goal, then = as_state(content["goal"]), int(content["stamp"])
        except (OSError, ValueError, KeyError, TypeError, OverflowError):
            return None
        is_same_clock = content.get("simulated") is simulated and then <= stamp
        return (goal, age) if is_same_clock and age <= self._keep else None
