# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""How long a plan may take on the wall clock, and for when it is made, while time runs on."""

from collections import deque

PLANNING_SHARE = 0.4
"""Part of the control period that planning may fill; the rest is for everybody else."""
MOST_LEAD = 0.5
"""Part of the control period that a plan is made ahead at the most: planning, and the way to the
drives."""
_LEAST_SHARE = 0.1
"""Part of the control period that even a late tick may plan for."""
_WINDOW, _SPACING, _ENOUGH = 0.5, 5e-3, 1e-2
"""Wall time over which the pace is measured, between its readings, and needed for it [s]."""
_LATELY = 8
"""Ticks that tell how long the next one will take."""
_MARGIN = 1.25
"""What the next one may take over the longest of these."""
_AT_ONCE = 0.02
"""Part of the control period up to which a command counts as sent at its instant."""
_STANDSTILL = 0.1
"""Wall time without progress that counts as a pause [s]."""


class PlanningTime:
    """Measure the pace of control time and share out the control period.

    Parameters
    ----------
    control_period : float
        Control time between two sample instants [s].
    simulated : bool
        Whether control time has a pace of its own; otherwise it is that of the wall clock.
    """

    def __init__(self, control_period: float, simulated: bool) -> None:
        self._period = control_period
        self._simulated = simulated
        self._readings: deque[tuple[float, float]] = deque()
        self._last = (float("-inf"), float("-inf"))
        self._took: deque[float] = deque(maxlen=_LATELY)

    @property
    def pace(self) -> float | None:
        """Control time over wall time; None until enough has been seen of it."""
        if not self._simulated:
            return 1.0
        if not self._readings:
            return None
        (then, wall_then), (now, wall) = self._readings[0], self._last
        return (now - then) / (wall - wall_then) if wall - wall_then >= _ENOUGH else None

    def read(self, now: float, wall: float) -> None:
        """Take note that control time is `now` [s] when the steady clock shows `wall` [s].

        Time that stands still or goes back tells nothing about the pace at which it runs.
        """
        last, wall_last = self._last
        if now == last and wall - wall_last < _STANDSTILL:
            return
        if now <= last:
            self._readings.clear()
        self._last = (now, wall)
        readings = self._readings
        if not readings or wall - readings[-1][1] >= _SPACING:
            readings.append((now, wall))
        while wall - readings[0][1] > _WINDOW and len(readings) > 1:
            readings.popleft()

    def budget(self, instant: float, now: float) -> float:
        """Return the wall time [s] for the plan of the sample instant `instant`, begun at `now`.

        Both are control times [s].
        """
        left = instant + PLANNING_SHARE * self._period - now
        return max(left, _LEAST_SHARE * self._period) / (self.pace or 1.0)

    def after(self, now: float, elapsed: float) -> float:
        """Return the control time [s] when `elapsed` of wall time [s] has passed since `now`."""
        return now + elapsed * (self.pace or 0.0)

    def took(self, duration: float) -> None:
        """Take note of the wall time between a sample instant and its command [s]."""
        self._took.append(duration * (self.pace or 1.0))

    def expect_all(self) -> None:
        """Expect that the next plan will use all the time it may, as a first one does."""
        self._took.append(PLANNING_SHARE * self._period)

    @property
    def lead(self) -> float:
        """How far beyond a sample instant to plan [s, control time].

        A plan that takes effect when it was made for is followed exactly. One that is late starts
        from where the rotors are by then, and has missed its arrival before it begins.
        """
        expected = _MARGIN * max(self._took, default=0.0)
        if expected < _AT_ONCE * self._period:
            return 0.0
        return min(expected, MOST_LEAD * self._period)
