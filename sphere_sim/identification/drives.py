# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Lag and limits of the drives: how measured rotor speeds follow what was commanded."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.estimation.motion import followed
from sphere_nmpc.model.first_order_hold import SAME, FirstOrderHold
from sphere_nmpc.model.state import Vector
from sphere_sim.evaluation.series import Series
from sphere_sim.identification.fitting import fitted

_BEYOND = 1.02
"""Command over the fitted limit from which on that limit was reached [-]."""
_LAGS = np.arange(0.0, 0.2, 0.01)
"""Lags that the fit may begin with [s]."""
_UNCERTAIN = 0.05
"""Relative deviation from which on a limit is not seen [-]."""
_HELD = 0.25
"""Time after a command of speeds for which drives follow it whatever their time-out is [s]."""
_GROUP = 2.0
"""Time within which errors may depend on each other [s]."""
_FEWEST = 50
"""Rotor speeds beside commands that are enough."""
_FOLLOWED = 0.3
"""Share of the rotor speeds that may remain unexplained where they follow the commands [-]."""
_UNLIMITED = 1e9
"""Limit beyond any [rad/s^2, rad/s]."""
_STEEP = 0.98
"""Share of the slopes below the acceleration that the fit begins with [-]."""


@dataclass(frozen=True, eq=False)
class Commands:
    """Commanded rotor speeds as straight pieces, and when they count.

    Attributes
    ----------
    times, speeds : ndarray, shapes (K,) and (K, 2)
        Ends of the pieces [s], equal ones at a jump, and speeds there [rad/s].
    ends : ndarray, shape (M, 2)
        Beginning and end of each time in which they are in force [s].
    """

    times: Vector
    speeds: Vector
    ends: Vector

    @classmethod
    def of_holds(cls, holds: Sequence[FirstOrderHold]) -> "Commands":
        """Return the speeds of trajectories, each of which replaces the one before it."""
        times, speeds = list[float](), list[Vector]()
        order = sorted(holds, key=lambda hold: hold.start)
        for i, hold in enumerate(order):
            until = order[i + 1].start if i + 1 < len(order) else hold.end
            if until < hold.start + SAME:
                continue
            knots = [hold.start, *hold.knots_between(hold.start, until), until]
            times += knots
            speeds += [hold.at(knot) for knot in knots]
        return cls(np.array(times), np.array(speeds), np.array([[times[0], times[-1]]]))

    @classmethod
    def of_speeds(cls, given: Series) -> "Commands":
        """Return the speeds of messages, held until the next one."""
        times = given.times
        ends = np.column_stack((times, np.append(times[1:], times[-1] + _HELD)))
        ends[:, 1] = np.minimum(ends[:, 1], times + _HELD)
        held = np.repeat(given.values, 2, axis=0)
        return cls(np.append(np.repeat(times, 2)[1:], times[-1] + _HELD), held, ends)

    def simplified(self) -> "Commands":
        """Return the speeds without ends between pieces that are one."""
        kept = np.ones(self.times.size, dtype=bool)
        same = np.all(self.speeds[1:-1] == self.speeds[:-2], axis=1)
        kept[1:-1] = ~(same & np.all(self.speeds[1:-1] == self.speeds[2:], axis=1))
        return Commands(self.times[kept], self.speeds[kept], self.ends)

    @property
    def steepest(self) -> float:
        """Largest acceleration that is asked for [rad/s^2], infinite at a jump."""
        steps, changes = np.diff(self.times), np.max(np.abs(np.diff(self.speeds, axis=0)), axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes = np.where(changes > 0.0, changes / steps, 0.0)
        return float(np.max(slopes, initial=0.0))


@dataclass(frozen=True)
class Drives:
    """Lag [s], largest acceleration [rad/s^2] and speed [rad/s] of the rotors.

    Each is a value with its standard deviation; a limit that was not reached is None. `attained`
    are the largest acceleration and speed that were commanded and followed, `left` is the root
    mean square of what is not explained [rad/s].
    """

    lag: tuple[float, float]
    acceleration: tuple[float, float] | None
    speed: tuple[float, float] | None
    attained: tuple[float, float]
    left: float


def identified_drives(commands: Commands, measured: Series) -> Drives | None:
    """Return what measured rotor speeds [rad/s] show; None where they do not follow."""
    commands, times = commands.simplified(), measured.times
    place = np.searchsorted(commands.ends[:, 0], times, side="right") - 1
    inside = (place >= 0) & (times <= commands.ends[np.maximum(place, 0), 1])
    beside = measured.where(inside)
    times, speeds = beside.times, beside.values
    if len(beside) < _FEWEST or not np.ptp(speeds, axis=0).any():
        return None
    groups = np.tile(((times - times[0]) / _GROUP).astype(np.intp), 2)
    first = np.concatenate((commands.times[:1], commands.times))
    largest = float(np.max(np.abs(commands.speeds)))

    def residuals(lag: float, acceleration: float, speed: float) -> Vector:
        found, limits = [], np.full(first.size - 1, acceleration)
        for given, measured in zip(commands.speeds.T, speeds.T, strict=True):
            wanted = np.clip(np.concatenate((measured[:1], given)), -speed, speed)
            corners, path = followed(first, wanted, -limits, limits)
            found.append(np.interp(times - lag, corners, path) - measured)
        return np.concatenate(found)

    steps = np.diff(times)
    slopes = np.abs(np.diff(speeds, axis=0)) / np.maximum(steps, np.median(steps))[:, None]
    steep, fast = float(np.quantile(slopes, _STEEP)), float(np.max(np.abs(speeds)))
    values = np.array([0.0, max(steep, 1.0), min(largest, fast)])
    costs = [float(np.sum(residuals(float(lag), *values[1:].tolist()) ** 2)) for lag in _LAGS]
    values[0] = _LAGS[int(np.argmin(costs))]
    unlimited = np.array([0.0, _UNLIMITED, _UNLIMITED])
    units = np.array([0.1, values[1], values[2]])
    free = np.ones(3, dtype=bool)
    while True:
        chosen = np.flatnonzero(free)

        def given(unknowns: Vector, chosen: NDArray[np.intp] = chosen) -> Vector:
            whole = unlimited.copy()
            whole[chosen] = unknowns
            whole[1:] = np.maximum(whole[1:], 1e-3)
            return residuals(*whole.tolist())

        found, deviations, left = fitted(given, values[chosen], units[chosen], groups)
        values[chosen] = found
        asked = np.array([np.inf, commands.steepest, largest])
        spread = np.zeros(3)
        spread[chosen] = deviations
        unseen = free & (asked < _BEYOND * values)
        unseen[1:] |= free[1:] & (spread[1:] > _UNCERTAIN * values[1:])
        if not unseen.any():
            break
        free &= ~unseen
    if not left < _FOLLOWED * float(np.sqrt(np.mean(speeds**2))):
        return None
    limits = {
        i: (float(value), float(deviation))
        for i, value, deviation in zip(chosen.tolist(), found, deviations, strict=True)
    }
    attained = min(commands.steepest, float(values[1])), largest
    return Drives(limits[0], limits.get(1), limits.get(2), attained, left)
