# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the knots of a plan lie in time."""

import numpy as np

from sphere_nmpc.model.state import Vector

SHORTEST = 0.3
"""Share of the period below which an interval is too weak to be worth knots of its own."""
_TOUCHING = 1e-4
"""Time to a knot [s] below which it is not told from now."""

MANOEUVRE = 4.0
"""Time planned in full detail at either end of a long way [s]."""


def knot_durations(duration: float, period: float, to_first_knot: float) -> Vector:
    """Return interval lengths that end at `duration`, knots on the ticks of the controller.

    The first interval reaches to the next tick and the last is as short as the arrival wants it.
    A long way is a manoeuvre, one long interval of steady rolling and another manoeuvre, so that
    the size of the problem does not grow with the distance.

    Parameters
    ----------
    duration : float
        Time to the arrival [s], positive.
    period : float
        Spacing of the ticks [s].
    to_first_knot : float
        Time to the first knot [s]; see `to_first_knot`.

    Returns
    -------
    ndarray, shape (N,)
    """
    last = duration - SHORTEST * period
    ticks: Vector = np.arange(to_first_knot, last, period, dtype=np.float64)
    if duration > 2.0 * MANOEUVRE + 2.0 * period:
        ticks = ticks[(ticks <= MANOEUVRE) | (ticks >= duration - MANOEUVRE)]
    return np.diff(np.concatenate(([0.0], ticks, [duration])))


def to_first_knot(now: float, origin: float, period: float, anew: bool) -> float:
    """Return the time to the first knot after `now` [s] of the grid that began at `origin`.

    A plan that is made anew leaves out a knot that is too near. One in hand bends there, however
    near, and could not be followed without it.

    Parameters
    ----------
    now, origin : float
        Times [s].
    period : float
        Spacing of the grid [s].
    anew : bool
        Whether there is no plan in hand.

    Returns
    -------
    float
        Positive [s].
    """
    left = period - float(np.mod(now - origin, period))
    return left + period if left < (SHORTEST * period if anew else _TOUCHING) else left
