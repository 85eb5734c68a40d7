# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Times of the knots of a plan."""

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

_SAME_TIME = 1e-4
"""Time to a knot [s] below which it counts as passed."""


def knot_durations(
    duration: float,
    period: float,
    to_first_knot: float,
    settings: TimeOptimalSettings,
    everywhere: bool = False,
) -> Vector:
    """Return interval lengths that end at `duration`, with knots at the sampling instants.

    The first interval reaches to the next sampling instant; the last is as short as the time of
    the arrival makes it. A long plan is a manoeuvre, one long interval of steady rolling and
    another manoeuvre, so that the size of the problem does not grow with the distance.

    Parameters
    ----------
    duration : float
        Time to the arrival [s], positive.
    period : float
        Sample period [s].
    to_first_knot : float
        Time to the first knot [s]; see `KnotGrid`.
    settings : TimeOptimalSettings
        Shortest interval, length of a manoeuvre.
    everywhere : bool, optional
        Whether a long plan has knots during steady rolling, too: with momentum the rotor speeds
        change there with each turn of the shell.

    Returns
    -------
    ndarray, shape (N,)
        Interval lengths [s].
    """
    last = duration - settings.shortest_interval * period
    instants: Vector = np.arange(to_first_knot, last, period, dtype=np.float64)
    manoeuvre = settings.manoeuvre_time
    if duration > 2.0 * manoeuvre + 2.0 * period and not everywhere:
        instants = instants[(instants <= manoeuvre) | (instants >= duration - manoeuvre)]
    return np.diff(np.concatenate(([0.0], instants, [duration])))


class KnotGrid:
    """Sampling instants at which the knots of all plans lie, until a reset.

    Parameters
    ----------
    period : float
        Sample period: spacing of the knots [s].
    settings : TimeOptimalSettings
        Shortest interval.
    """

    def __init__(self, period: float, settings: TimeOptimalSettings) -> None:
        self._period = period
        self._shortest = settings.shortest_interval * period
        self._origin: float | None = None

    def begin(self, now: float) -> None:
        """Begin the grid at `now` [s] unless it has begun."""
        if self._origin is None:
            self._origin = now

    def begin_again(self, now: float) -> None:
        """Begin the grid at `now` [s]."""
        self._origin = now

    def origin(self, now: float) -> float:
        """Return the control time of one of the knots [s]: `now` if the grid has not begun."""
        return now if self._origin is None else self._origin

    def to_first_knot(self, now: float, new_plan: bool) -> float:
        """Return the time from `now` [s] to the first knot after it [s], positive.

        A new plan leaves out a knot that is too near. A plan that is being followed changes its
        slope there, however near, and would not be feasible without it.
        """
        left = self._period - float(np.mod(now - self.origin(now), self._period))
        shortest = self._shortest if new_plan else _SAME_TIME
        return left + self._period if left < shortest else left
