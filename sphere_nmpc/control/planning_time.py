# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time budget of a plan on the wall clock, and how far ahead a plan is made."""

from collections import deque

PLANNING_SHARE = 0.4
"""Share of the control period that planning may take; the rest is for other processes."""
MOST_LEAD = 0.5
"""Largest share of the control period by which a plan is made ahead, for planning and the
transport of its command."""
_LEAST_SHARE = 0.1
"""Share of the control period that planning may take even at a late tick."""
_WINDOW, _SPACING, _ENOUGH = 0.5, 5e-3, 1e-2
"""Wall time over which the pace is measured, between two readings, and at least needed [s]."""
_RECENT = 8
"""Newest ticks from whose durations that of the next one is predicted."""
_MARGIN = 1.25
"""Predicted duration over the longest of these."""
_NEGLIGIBLE = 0.02
"""Share of the control period up to which a command counts as sent at its instant."""
_STANDSTILL = 0.1
"""Wall time without progress of control time that counts as a pause [s]."""


class PlanningTime:
    """Time budget and lead of the next plan, from the measured pace of control time.

    Parameters
    ----------
    control_period : float
        Control time between two sampling instants [s].
    simulated : bool
        Whether the pace of control time has to be measured; otherwise it is 1.
    """

    def __init__(self, control_period: float, simulated: bool) -> None:
        self._period = control_period
        self._simulated = simulated
        self._readings: deque[tuple[float, float]] = deque()
        self._last = (float("-inf"), float("-inf"))
        self._took: deque[float] = deque(maxlen=_RECENT)

    @property
    def pace(self) -> float | None:
        """Control time over wall time; None until it has been measured for long enough."""
        if not self._simulated:
            return 1.0
        if not self._readings:
            return None
        (then, wall_then), (now, wall) = self._readings[0], self._last
        return (now - then) / (wall - wall_then) if wall - wall_then >= _ENOUGH else None

    def read(self, now: float, wall: float) -> None:
        """Record that control time is `now` [s] when the steady clock shows `wall` [s].

        A standstill and a jump back restart the measurement; after a standstill it begins when
        control time has advanced. Where the process was held up, a pose may be handled before the
        message of the clock: from that pose on, time would advance by as much within milliseconds.
        """
        last, wall_last = self._last
        if now == last:
            if wall - wall_last >= _STANDSTILL:
                self._readings.clear()
            return
        if now < last:
            self._readings.clear()
        self._last = (now, wall)
        readings = self._readings
        if not readings or wall - readings[-1][1] >= _SPACING:
            readings.append((now, wall))
        while wall - readings[0][1] > _WINDOW and len(readings) > 1:
            readings.popleft()

    def budget(self, instant: float, now: float) -> float:
        """Return the wall time [s] that the plan of a sampling instant may take.

        It is requested at `now`; both `instant` and `now` are control times [s].
        """
        left = instant + PLANNING_SHARE * self._period - now
        return max(left, _LEAST_SHARE * self._period) / (self.pace or 1.0)

    def after(self, now: float, elapsed: float) -> float:
        """Return the control time [s] when `elapsed` of wall time [s] has passed since `now`."""
        return now + elapsed * (self.pace or 0.0)

    def took(self, duration: float, late: float) -> None:
        """Record the wall time [s] between the request of a plan and its command.

        The request was `late` [s, control time] behind its sampling instant.
        """
        self._took.append(late + duration * (self.pace or 1.0))

    @property
    def lead(self) -> float:
        """Lead of a plan: predicted delay of its command behind the instant [s, control time].

        A plan that takes effect at the instant it was made for is followed exactly. A command
        that is late has to start from the rotor speeds at that time, and departs from its plan.
        """
        expected = _MARGIN * max(self._took, default=0.0)
        if expected < _NEGLIGIBLE * self._period:
            return 0.0
        return min(expected, MOST_LEAD * self._period)
