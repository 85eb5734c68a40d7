# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether the sphere has arrived: the error has stayed small for a while, not just passed by."""

_LEAVING = 2.0
"""Error over the tolerance at which the goal is left again; noise at the edge does not flicker."""


class Arrival:
    """Tell from the error over time whether the sphere is at the goal."""

    def __init__(self) -> None:
        self._inside_since: float | None = None
        self.reached = False
        """Whether the sphere is at the goal."""

    def reset(self) -> None:
        """Forget what was seen, as with a new goal."""
        self._inside_since = None
        self.reached = False

    def update(self, time: float, error: float, tolerance: float, dwell: float) -> bool:
        """Take note of the error at a sample instant and return whether the goal is reached.

        Parameters
        ----------
        time : float
            Sample instant [s].
        error : float
            Distance to the goal [mixed units]; nan counts as far away.
        tolerance : float
            Error below which the sphere is inside [mixed units].
        dwell : float
            For how long it has to stay inside [s].
        """
        if not error < (_LEAVING * tolerance if self.reached else tolerance):
            self.reset()
        elif self._inside_since is None or time < self._inside_since:
            self._inside_since = time
        if self._inside_since is not None and time >= self._inside_since + dwell:
            self.reached = True
        return self.reached
