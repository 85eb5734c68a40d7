# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Stop on the planned path: the plan at a pace that falls from one to zero.

Without momentum the motion has no drift: at the rotor speeds sigma u(s), ds/dt = sigma, the
sphere passes the same poses as at the speeds u(t), at another pace sigma. The pace falls as fast
as the limit of the rotors' acceleration allows, which a rotor that is just being reversed uses
already.
"""

import math
from bisect import bisect_right

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector

_STEP = 0.02
"""Spacing of the knots of a stop [s]: between them it leaves the path by less than 0.4 mm."""
_SHARE = 1.0 - 1e-8
"""Share of the limit that is used, as what exceeds it by rounding would have to be made up for."""


def stop_on_path(hold: FirstOrderHold, max_acceleration: float) -> FirstOrderHold:
    """Return the hold along the same path that comes to rest as soon as possible.

    Parameters
    ----------
    hold : FirstOrderHold
        Plan from now on, which ends at rest and exceeds no limit.
    max_acceleration : float
        Limit of the rotors' acceleration [rad/s^2].
    """
    limit = _SHARE * max_acceleration
    times, rows = hold.times.tolist(), hold.speeds.tolist()

    def planned(time: float) -> tuple[float, float]:
        # Every command has such a stop at its end; single values are fastest in lists.
        i = bisect_right(times, time)
        if i == len(times):
            return rows[-1][0], rows[-1][1]
        share = (time - times[i - 1]) / (times[i] - times[i - 1])
        (x, y), (next_x, next_y) = rows[i - 1], rows[i]
        return x + share * (next_x - x), y + share * (next_y - y)

    reach, place, pace = limit * _STEP, hold.start, 1.0
    first, second = rows[0]
    knots = [(first, second)]
    while (first or second) and place < hold.end:
        # A lower pace leads to a place between these two.
        x, y = planned(place + 0.5 * pace * _STEP)
        next_x, next_y = planned(place + pace * _STEP)
        slower = max(
            _slowest(first, x, (next_x - x) / pace, reach),
            _slowest(second, y, (next_y - y) / pace, reach),
        )
        if slower == 0.0:
            break
        slower = min(slower, pace)
        place, pace = place + 0.5 * (pace + slower) * _STEP, slower
        x, y = planned(place)
        first, second = pace * x, pace * y
        knots.append((first, second))
    spaced: Vector = hold.start + _STEP * np.arange(len(knots), dtype=np.float64)
    stop = FirstOrderHold(spaced, np.array(knots))
    return stop.limited(math.inf, limit).ending_at_rest(limit)


def _slowest(speed: float, planned: float, rise: float, reach: float) -> float:
    """Return the lowest pace p at the next knot for a rotor that turns at `speed` now [rad/s].

    Its speed there is p (planned + rise p), and may be lower than now by `reach` [rad/s]. It is
    infinite where the plan itself slows this rotor down as fast as that.
    """
    if speed < 0.0:
        speed, planned, rise = -speed, -planned, -rise
    least = speed - reach
    if least <= 0.0:
        return 0.0
    square = planned * planned + 4.0 * rise * least
    divisor = planned + math.sqrt(square) if square >= 0.0 else 0.0
    return 2.0 * least / divisor if divisor > 0.0 else math.inf
