# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Detection of the arrival: the error has stayed below the tolerance for some time."""

_LEAVING = 2.0
"""Ratio of error and tolerance above which the goal counts as left: hysteresis against noise."""


class Arrival:
    """Detector of the arrival at the goal from the error over time."""

    def __init__(self) -> None:
        self._away_since: float | None = None
        self._inside_since: float | None = None
        self.reached = False
        """Whether the sphere is at the goal."""
        self.took = float("nan")
        """Time [s] of the newest arrival: from the first sample, or from when the goal was left,
        until the error was within the tolerance."""

    def reset(self) -> None:
        """Discard past errors, as after an interruption."""
        if self.reached:
            self._away_since = None
        self._inside_since = None
        self.reached = False

    def update(self, time: float, error: float, tolerance: float, dwell: float) -> bool:
        """Record the error at a sampling instant and return whether the goal is reached.

        Parameters
        ----------
        time : float
            Sampling instant [s].
        error : float
            Distance to the goal [mixed units]; nan counts as not within the tolerance.
        tolerance : float
            Error below which the sphere is at the goal [mixed units].
        dwell : float
            Time for which the error has to stay below the tolerance [s].
        """
        if not error < (_LEAVING * tolerance if self.reached else tolerance):
            self.reset()
        elif self._inside_since is None or time < self._inside_since:
            self._inside_since = time
        if self._away_since is None or time < self._away_since:
            self._away_since = time
        if self._inside_since is not None and time >= self._inside_since + dwell:
            if not self.reached:
                self.took = self._inside_since - self._away_since
            self.reached = True
        return self.reached
