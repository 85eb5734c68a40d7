# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the knots of a plan lie in time."""

import numpy as np

from sphere_nmpc.model.state import Vector

SHORTEST = 0.3
"""Intervals shorter than this share of the period are joined to a neighbour: too weak alone."""

MANOEUVRE = 4.0
"""Time planned in full detail at either end of a long way [s]."""


def knot_durations(duration: float, period: float, to_next_tick: float) -> Vector:
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
    to_next_tick : float
        Time to the next tick [s], in (0, period].

    Returns
    -------
    ndarray, shape (N,)
    """
    if to_next_tick < SHORTEST * period:
        to_next_tick += period
    last = duration - SHORTEST * period
    ticks: Vector = np.arange(to_next_tick, last, period, dtype=np.float64)
    if duration > 2.0 * MANOEUVRE + 2.0 * period:
        ticks = ticks[(ticks <= MANOEUVRE) | (ticks >= duration - MANOEUVRE)]
    return np.diff(np.concatenate(([0.0], ticks, [duration])))
