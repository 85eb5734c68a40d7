# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time budget of a plan on the wall clock, and how far ahead a plan is made."""

from collections import deque

from sphere_nmpc.control.clock_watch import MOST_AHEAD, ClockWatch

PLANNING_SHARE = 0.4
"""Share of the control period that planning may take; the rest is for other processes."""
MOST_LEAD = 0.5
"""Largest share of the control period by which a plan is made ahead, for planning and the
transport of its command."""
_LEAST_SHARE = 0.1
"""Share of the control period that planning may take even at a late tick."""
_RECENT = 8
"""Newest ticks from whose durations that of the next one is predicted."""
_MARGIN = 1.25
"""Predicted duration over the longest of these."""
_NEGLIGIBLE = 0.02
"""Share of the control period up to which a command counts as sent at its instant."""


class PlanningTime:
    """Time budget and lead of the next plan, from the measured pace of control time.

    Parameters
    ----------
    control_period : float
        Control time between two sampling instants [s].
    watch : ClockWatch
        Pace of control time.
    """

    def __init__(self, control_period: float, watch: ClockWatch) -> None:
        self._period = control_period
        self._watch = watch
        self._took: deque[float] = deque(maxlen=_RECENT)

    def budget(self, instant: float, now: float) -> float:
        """Return the wall time [s] that the plan of a sampling instant may take.

        It is requested at `now`; both `instant` and `now` are control times [s].
        """
        left = instant + PLANNING_SHARE * self._period - now
        return max(left, _LEAST_SHARE * self._period) / (self._watch.pace or 1.0)

    def after(self, now: float, elapsed: float) -> float:
        """Return the control time [s] when `elapsed` of wall time [s] has passed since `now`.

        It is no more than `MOST_AHEAD` later: a command must not begin long after the clock that
        is known, however long it took and whatever pace was measured.
        """
        return now + min(elapsed * (self._watch.pace or 0.0), MOST_AHEAD)

    def took(self, duration: float, late: float) -> None:
        """Record the wall time [s] between the request of a plan and its command.

        The request was `late` [s, control time] behind its sampling instant.
        """
        self._took.append(late + duration * (self._watch.pace or 1.0))

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
