# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""First guesses for the search: manoeuvre, steady rolling, manoeuvre."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import INPUT_SIZE

_SHORTEST_CRUISE = 0.3
"""Shorter stretches of steady rolling [s] are not worth a knot."""

_BEND = 0.4
"""Mean spacing of the random knots of a manoeuvre [s]."""

_MANOEUVRES = 0.8
"""Time left for the two manoeuvres at the least [s]."""


def cruise_speed(constants: LumpedConstants, max_speed: float) -> float:
    """Return the speed of steady rolling with both rotors at their limit [m/s].

    With the contact axis across the rotors' resultant, the shell turns about a horizontal axis
    that stays where it is: the centre rolls straight on at Rs c1 sqrt(2) u_max.
    """
    return constants.shell_radius * constants.input_gain * float(np.sqrt(2.0)) * max_speed


def random_guess(
    rng: np.random.Generator, duration: float, distance: float, speed: float, max_speed: float
) -> FirstOrderHold:
    """Draw rotor speeds from rest to rest.

    Parameters
    ----------
    rng : Generator
        Source of randomness.
    duration : float
        Time to the arrival [s].
    distance : float
        Way to go [m].
    speed : float
        Speed of steady rolling [m/s].
    max_speed : float
        Limit of the rotor speeds [rad/s].
    """
    cruise = min(distance / speed * rng.uniform(0.3, 1.0), duration - _MANOEUVRES)
    if cruise < _SHORTEST_CRUISE:
        bends = int(rng.integers(4, 8))
        times = np.linspace(0.0, duration, bends + 1)
        return _between_rests(times, rng.uniform(-max_speed, max_speed, (bends + 1, INPUT_SIZE)))
    begin = (duration - cruise) * rng.uniform(0.25, 0.75)
    end = begin + cruise
    before = max(1, round(begin / _BEND))
    after = max(1, round((duration - end) / _BEND))
    times = np.concatenate(
        (np.linspace(0.0, begin, before + 1), np.linspace(end, duration, after + 1))
    )
    speeds = rng.uniform(-max_speed, max_speed, (times.size, INPUT_SIZE))
    speeds[before] = speeds[before + 1] = rng.choice([-max_speed, max_speed], INPUT_SIZE)
    return _between_rests(times, speeds)


def shaken(
    rng: np.random.Generator, hold: FirstOrderHold, amount: float, max_speed: float
) -> FirstOrderHold:
    """Return `hold` with a smooth random disturbance of at most `amount` times the limit."""
    bends = int(rng.integers(4, 8))
    times = np.linspace(0.0, hold.end, bends + 1)
    change = amount * rng.uniform(-max_speed, max_speed, (bends + 1, INPUT_SIZE))
    change[0] = change[-1] = 0.0
    added = np.column_stack([np.interp(hold.times, times, column) for column in change.T])
    return FirstOrderHold(hold.times, hold.speeds + added)


def _between_rests(times: NDArray[Any], speeds: NDArray[Any]) -> FirstOrderHold:
    speeds[0] = speeds[-1] = 0.0
    return FirstOrderHold(times, speeds)
