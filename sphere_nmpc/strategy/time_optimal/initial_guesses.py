# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random initial guesses of the search: manoeuvre, steady rolling, manoeuvre."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import INPUT_SIZE
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

_INTERVALS = (4, 8)
"""Range of the number of intervals of a guess without steady rolling; the end is excluded."""
_CRUISE = (0.3, 1.0)
"""Range of the duration of steady rolling, over that of the whole distance at full speed."""
_FIRST_MANOEUVRE = (0.25, 0.75)
"""Range of the share that the first manoeuvre has of the time of both."""


def cruise_speed(constants: LumpedConstants, max_speed: float) -> float:
    """Return the speed of steady rolling with both rotors at their limit [m/s].

    With the contact axis perpendicular to the resultant of the two rotor speeds, the shell turns
    about a horizontal axis of constant direction: the centre rolls in a straight line at
    Rs c1 sqrt(2) u_max.

    Parameters
    ----------
    constants : LumpedConstants
        Constants of the motion.
    max_speed : float
        Limit of the rotor speeds u_max [rad/s].
    """
    return constants.shell_radius * constants.input_gain * float(np.sqrt(2.0)) * max_speed


def random_guess(
    rng: np.random.Generator,
    duration: float,
    distance: float,
    speed: float,
    max_speed: float,
    settings: TimeOptimalSettings,
) -> FirstOrderHold:
    """Draw rotor speeds from rest to rest.

    Parameters
    ----------
    rng : Generator
        Source of random numbers.
    duration : float
        Time to the arrival [s].
    distance : float
        Distance to the goal [m].
    speed : float
        Speed of steady rolling [m/s].
    max_speed : float
        Limit of the rotor speeds [rad/s].
    settings : TimeOptimalSettings
        Durations of steady rolling and manoeuvres, spacing of the knots.

    Returns
    -------
    FirstOrderHold
        From time 0 to `duration`.
    """
    cruise = min(
        distance / speed * rng.uniform(*_CRUISE), duration - settings.least_manoeuvres
    )
    if cruise < settings.shortest_cruise:
        intervals = int(rng.integers(*_INTERVALS))
        times = np.linspace(0.0, duration, intervals + 1)
        speeds = rng.uniform(-max_speed, max_speed, (intervals + 1, INPUT_SIZE))
        return _from_rest_to_rest(times, speeds)
    begin = (duration - cruise) * rng.uniform(*_FIRST_MANOEUVRE)
    end = begin + cruise
    before = max(1, round(begin / settings.guess_spacing))
    after = max(1, round((duration - end) / settings.guess_spacing))
    times = np.concatenate(
        (np.linspace(0.0, begin, before + 1), np.linspace(end, duration, after + 1))
    )
    speeds = rng.uniform(-max_speed, max_speed, (times.size, INPUT_SIZE))
    speeds[before] = speeds[before + 1] = rng.choice([-max_speed, max_speed], INPUT_SIZE)
    return _from_rest_to_rest(times, speeds)


def perturbed(
    rng: np.random.Generator, hold: FirstOrderHold, amount: float, max_speed: float
) -> FirstOrderHold:
    """Return `hold` with a piecewise linear random perturbation of its speeds.

    Parameters
    ----------
    rng : Generator
        Source of random numbers.
    hold : FirstOrderHold
        Rotor speeds from time 0 on [rad/s].
    amount : float
        Largest change [of the speed limit].
    max_speed : float
        Limit of the rotor speeds [rad/s].
    """
    intervals = int(rng.integers(*_INTERVALS))
    times = np.linspace(0.0, hold.end, intervals + 1)
    change = amount * rng.uniform(-max_speed, max_speed, (intervals + 1, INPUT_SIZE))
    change[0] = change[-1] = 0.0
    added = np.column_stack([np.interp(hold.times, times, column) for column in change.T])
    return FirstOrderHold(hold.times, hold.speeds + added)


def _from_rest_to_rest(times: NDArray[Any], speeds: NDArray[Any]) -> FirstOrderHold:
    speeds[0] = speeds[-1] = 0.0
    return FirstOrderHold(times, speeds)
