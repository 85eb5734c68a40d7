# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The goal in force, kept in a file for a controller that is started again on the way."""

import json
import os
import time
from pathlib import Path

from sphere_nmpc.cache import make_private
from sphere_nmpc.model.state import Vector, as_state


class GoalMemory:
    """Keep the goal in a small file, with the time at which it was last in force.

    The goal is taken up again only by a controller that starts soon after the end of the last
    one, on the same clock, which has gone on since: a simulation that begins anew begins without
    a goal.

    Parameters
    ----------
    path : Path
        The file; its folder is made when it is first written.
    keep : float
        For how long after the end of a controller its goal is taken up [s, wall].
    """

    def __init__(self, path: Path, keep: float) -> None:
        self._path = path
        self._keep = keep

    def save(self, goal: Vector | None, stamp: int, simulated: bool) -> None:
        """Write the goal, shape (6,), in force at `stamp` [ns]; without one forget the last.

        `simulated` tells the clock of the stamp: simulated time, or that of the system.

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
        make_private(self._path.parent)
        # A process that is killed while it writes must leave the old file or the new one.
        fresh = self._path.with_suffix(f".{os.getpid()}")
        content = {"goal": goal.tolist(), "stamp": stamp, "simulated": simulated}
        fresh.write_text(json.dumps(content), encoding="ascii")
        fresh.replace(self._path)

    def recall(self, stamp: int, simulated: bool) -> tuple[Vector, float] | None:
        """Return the goal of a controller that has just ended, and how long ago [s, wall].

        None where there is none, it ended too long ago, or the clock is another one or, now that
        it shows `stamp` [ns], has begun anew since.
        """
        try:
            age = max(0.0, time.time() - self._path.stat().st_mtime)
            content = json.loads(self._path.read_text(encoding="ascii"))
            goal, then = as_state(content["goal"]), int(content["stamp"])
        except (OSError, ValueError, KeyError, TypeError, OverflowError):
            return None
        goes_on = content.get("simulated") is simulated and then <= stamp
        return (goal, age) if goes_on and age <= self._keep else None
