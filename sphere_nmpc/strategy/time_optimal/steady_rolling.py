# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Steady rolling: both rotors at their limit, the axis horizontal and fixed in the body.

The sphere then rolls in a straight line at its greatest speed (``docs/time_bound.md``), and with
each turn of the shell the same orientation returns. Whole turns can therefore be left out of a
plan or added to it.
"""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.first_order_hold import SAME, FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants

_MIN_INTEGRATED_TURNS = 0.5
"""Turns that remain in an interval of steady rolling when whole ones are left out, at the least:
the displacement over them stands for that over all turns."""

_LIMIT_SHARE = 0.9
"""Share of the speed limit beyond which a rotor counts as being at it."""
_MANOEUVRE_TIME = 2.0
"""Time beyond that of steady rolling that a motion takes [s]."""


@dataclass(frozen=True)
class SteadyRolling:
    """Steady rolling of a robot.

    Attributes
    ----------
    speed : float
        Speed of the centre [m/s].
    turn_time : float
        Time of a turn of the shell [s].
    """

    speed: float
    turn_time: float

    @classmethod
    def of(cls, constants: LumpedConstants, max_speed: float) -> "SteadyRolling":
        """Return that of a robot whose rotors turn at `max_speed` [rad/s] at most."""
        rate = constants.input_gain * float(np.sqrt(2.0)) * max_speed
        return cls(constants.shell_radius * rate, 2.0 * float(np.pi) / rate)

    @property
    def turn_length(self) -> float:
        """Distance of a turn of the shell [m]."""
        return self.speed * self.turn_time

    def duration(self, way: float) -> float:
        """Return about how long a motion over `way` [m] from rest to rest takes [s]."""
        return _MANOEUVRE_TIME + way / self.speed


def steady_interval(
    hold: FirstOrderHold, rolling: SteadyRolling, max_speed: float
) -> tuple[int, int]:
    """Return the index of the interval of steady rolling and the whole turns left out of it.

    Both are 0 without one: there the rotors are at the limit `max_speed` [rad/s].
    """
    longest = int(np.argmax(hold.durations))
    turns = max(0, int(float(hold.durations[longest]) / rolling.turn_time - _MIN_INTEGRATED_TURNS))
    if not turns or np.any(np.abs(hold.speeds[longest : longest + 2]) < _LIMIT_SHARE * max_speed):
        return 0, 0
    return longest, turns


def slowed(
    hold: FirstOrderHold, is_steady: bool, margin: float = 0.0, longer: float = 0.0
) -> FirstOrderHold:
    """Return rotor speeds, from time 0 on, that lead along the same path in more time.

    They are slower by a share of the time, or take `longer` [s]. An interval of steady rolling, if
    there `is_steady` one, is kept.
    """
    durations, speeds = hold.durations.copy(), hold.speeds.copy()
    slower = np.ones(durations.size, dtype=bool)
    slower[np.argmax(durations)] = not is_steady
    factor = 1.0 + margin + longer / float(np.sum(durations[slower]))
    durations[slower] *= factor
    speeds[np.append(slower, True) & np.append(True, slower)] /= factor
    return FirstOrderHold(np.concatenate(([0.0], np.cumsum(durations))), speeds)


def with_turns(hold: FirstOrderHold, added: float, max_speed: float) -> FirstOrderHold:
    """Return rotor speeds that roll steadily for a time `added` [s] in their longest such part.

    They begin at time 0 and keep the limit `max_speed` [rad/s].
    """
    times, speeds = hold.times, hold.speeds
    at_limit = np.where(np.abs(speeds) > _LIMIT_SHARE * max_speed, np.sign(speeds), 0.0)
    place, longest, begin = 0.5 * hold.end, 0.0, 0
    for i in range(times.size):
        if not at_limit[i].all() or not np.array_equal(at_limit[i], at_limit[begin]):
            begin = i
        elif times[i] - times[begin] > longest:
            place, longest = 0.5 * (times[begin] + times[i]), times[i] - times[begin]
    corner = np.copysign(max_speed, hold.at(place))
    before, after = times < place - SAME, times > place + SAME
    return FirstOrderHold(
        np.concatenate((times[before], [place, place + added], times[after] + added)),
        np.vstack((speeds[before], corner, corner, speeds[after])),
    )


def without_turns(hold: FirstOrderHold, interval: int, left_out: float) -> FirstOrderHold:
    """Return rotor speeds whose interval of steady rolling is shorter by `left_out` [s]."""
    times = hold.times.copy()
    times[interval + 1 :] -= left_out
    return FirstOrderHold(times, hold.speeds)
