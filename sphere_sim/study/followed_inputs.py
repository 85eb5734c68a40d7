# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speeds commanded over a whole run, as one first-order hold."""

from collections.abc import Iterable

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import INPUT_SIZE, Vector


def followed_inputs(holds: Iterable[FirstOrderHold], duration: float) -> FirstOrderHold:
    """Join all commands of a run into one hold from 0 to `duration` [s].

    Parameters
    ----------
    holds : iterable of FirstOrderHold
        In the order in which they took effect; each replaces the previous ones from its first knot
        on.
    duration : float
        Length of the run [s].

    Returns
    -------
    FirstOrderHold
        Its first knot is at 0 and its last one at `duration`.
    """
    times: list[float] = []
    speeds: list[Vector] = []
    for hold in holds:
        while times and times[-1] >= hold.start - 1e-9:
            times.pop()
            speeds.pop()
        times.extend(float(t) for t in hold.times)
        speeds.extend(hold.speeds)
    if not times:
        return FirstOrderHold(np.array([0.0, duration]), np.zeros((2, INPUT_SIZE)))
    whole = FirstOrderHold(np.array(times), np.array(speeds))
    if whole.start > 0.0:
        # Before the first command the rotors are at rest.
        times.insert(0, 0.0)
        speeds.insert(0, np.zeros(INPUT_SIZE))
    inside = [i for i, time in enumerate(times) if time < duration - 1e-9]
    return FirstOrderHold(
        np.append([times[i] for i in inside], duration),
        np.vstack([*(speeds[i] for i in inside), whole.at(duration)]),
    )
