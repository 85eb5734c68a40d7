# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speeds as a continuous, piecewise linear function of time (Eqs. 21 and 22)."""

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from functools import cached_property
from operator import lt

import numpy as np

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.quantities import NANOSECONDS

SAME = 1e-9
"""Times [s] and speeds [rad/s] that differ by less are the same."""
FASTEST = 1e6
"""Largest rotor speed [rad/s]; far beyond it differences over short times overflow."""
SHORTEST = 1e-6
"""Shortest interval between two knots of a command [s]: a thousand times the resolution of a
stamp."""
_STOP_SPACING = 0.02
"""Spacing of the knots of a stop [s]: between them it leaves the path by less than 0.4 mm."""
_SHARE = 1.0 - 1e-8
"""Share of the limit that is used, as what exceeds it by rounding would have to be made up for."""


@dataclass(frozen=True, eq=False)
class FirstOrderHold:
    """Linear interpolation between knots; constant before the first and after the last.

    Attributes
    ----------
    times : ndarray, shape (K,)
        Times of the knots [s], strictly increasing.
    speeds : ndarray, shape (K, 2)
        Rotor speeds at the knots [rad/s].
    start, end : float
        Times of the first and of the last knot [s].

    Raises
    ------
    InvalidInputError
        If the shapes do not fit, a number is not finite, a speed is beyond `FASTEST`, or the times
        do not increase.
    """

    times: Vector
    speeds: Vector
    start: float = field(init=False, repr=False)
    end: float = field(init=False, repr=False)
    _knots: list[float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times = np.array(self.times, dtype=float)
        speeds = np.array(self.speeds, dtype=float)
        if times.ndim != 1 or times.size == 0 or speeds.shape != (times.size, INPUT_SIZE):
            raise InvalidInputError(
                "first-order hold", (times.shape, speeds.shape),
                f"the shapes of times, (K,) [s], and of speeds, (K, {INPUT_SIZE}), with K >= 1",
            )
        # On so few numbers Python is faster than NumPy, and this runs several times a control
        # period.
        knots, numbers = times.tolist(), speeds.ravel().tolist()
        if not all(map(math.isfinite, knots + numbers)):
            raise InvalidInputError("first-order hold", [knots, speeds.tolist()], "finite numbers")
        if max(numbers) > FASTEST or min(numbers) < -FASTEST:
            raise InvalidInputError(
                "rotor speeds", speeds.tolist(), f"at most {FASTEST:g} rad/s in either direction"
            )
        if not all(map(lt, knots, knots[1:])):
            raise InvalidInputError("first-order hold", knots, "strictly rising times [s]")
        self._keep(times, speeds)

    def _keep(self, times: Vector, speeds: Vector) -> None:
        times.flags.writeable = False
        speeds.flags.writeable = False
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "speeds", speeds)
        # Single values are read much faster from a list than from an array.
        knots = times.tolist()
        object.__setattr__(self, "_knots", knots)
        object.__setattr__(self, "start", knots[0])
        object.__setattr__(self, "end", knots[-1])

    @classmethod
    def _unchecked(cls, times: Vector, speeds: Vector) -> "FirstOrderHold":
        """Return a hold of arrays that are valid by construction and not referenced elsewhere."""
        hold = object.__new__(cls)
        hold._keep(times, speeds)
        return hold

    @cached_property
    def durations(self) -> Vector:
        """Lengths of the intervals between knots [s], shape (K - 1,)."""
        times = self.times
        return times[1:] - times[:-1]

    @classmethod
    def constant(cls, time: float, speeds: Vector) -> "FirstOrderHold":
        """Return a hold of one knot: constant speeds."""
        return cls(np.array([time]), np.asarray(speeds, dtype=float).reshape(1, INPUT_SIZE))

    def at(self, time: float) -> Vector:
        """Return the rotor speeds at `time` [rad/s], shape (2,)."""
        knots = self._knots
        i = bisect_right(knots, time) - 1
        if i < 0:
            return self.speeds[0].copy()
        if i >= len(knots) - 1 or knots[i] == time:
            return self.speeds[i].copy()
        here = self.speeds[i]
        speeds: Vector = (self.speeds[i + 1] - here) / (knots[i + 1] - knots[i])
        speeds *= time - knots[i]
        speeds += here
        return speeds

    def turned(self, time: float) -> Vector:
        """Return the angles by which the rotors turn up to `time` [rad], shape (2,)."""
        knots = bisect_left(self._knots, time)
        times = np.append(self.times[:knots], min(max(time, self.start), self.end))
        speeds = np.vstack((self.speeds[:knots], self.at(time)))
        return 0.5 * np.diff(times) @ (speeds[1:] + speeds[:-1])

    def resampled(self, times: Vector) -> "FirstOrderHold":
        """Return the hold with knots at other times [s], strictly increasing, between its own."""
        speeds = np.column_stack([np.interp(times, self.times, row) for row in self.speeds.T])
        return FirstOrderHold(times, speeds)

    def knots_until(self, time: float) -> int:
        """Return the number of knots up to a time [s], itself included; at least 1."""
        return max(1, bisect_right(self._knots, time))

    def knots_between(self, since: float, until: float) -> list[float]:
        """Return the times of the knots strictly between two times [s]."""
        knots = self._knots
        return knots[bisect_right(knots, since) : bisect_left(knots, until)]

    def delayed(self, offset: float) -> "FirstOrderHold":
        """Return the same hold `offset` seconds later."""
        return FirstOrderHold(self.times + offset, self.speeds)

    def starting_at(
        self, time: float, speeds: Vector, shortest: float = SAME
    ) -> "FirstOrderHold":
        """Return the hold that starts with `speeds` at `time` and meets this one at its next knot.

        For a command that takes effect late: knots up to `shortest` [s] after `time` are dropped,
        and the ramp starts from the speeds in force.
        """
        first = bisect_right(self._knots, time + shortest)
        times = np.array([time, *self._knots[first:]])
        knots = np.empty((times.size, INPUT_SIZE))
        knots[0] = speeds
        knots[1:] = self.speeds[first:]
        if not (math.isfinite(time) and np.isfinite(knots[0]).all()):
            raise InvalidInputError("first-order hold", [time, *knots[0]], "a finite start")
        return FirstOrderHold._unchecked(times, knots)

    def until(self, time: float) -> "FirstOrderHold":
        """Return the hold without what comes after `time` [s], which is later than its start."""
        if self.end <= time:
            return self
        last = bisect_left(self._knots, time)
        times = np.array([*self._knots[:last], time])
        return FirstOrderHold._unchecked(times, np.vstack((self.speeds[:last], self.at(time))))

    def followed_by(self, hold: "FirstOrderHold") -> "FirstOrderHold":
        """Return the hold with the knots of another one, which starts where this one ends."""
        times = np.concatenate((self.times, hold.times[1:]))
        return FirstOrderHold._unchecked(times, np.concatenate((self.speeds, hold.speeds[1:])))

    def in_nanoseconds(self) -> "FirstOrderHold":
        """Return the hold with knots at whole nanoseconds, without those that nearly coincide.

        A receiver that reads the stamps then finds the accelerations that `limited` has set.
        """
        times = np.rint(self.times * NANOSECONDS) / NANOSECONDS
        knots, kept = times.tolist(), [0]
        for i, time in enumerate(knots):
            if time - knots[kept[-1]] >= SHORTEST:
                kept.append(i)
        if len(kept) < times.size:
            return FirstOrderHold._unchecked(times[kept], self.speeds[kept])
        return FirstOrderHold._unchecked(times, self.speeds)

    def stop(self, time: float, max_acceleration: float) -> "FirstOrderHold":
        """Return the hold up to `time` [s], and from then on to rest as soon as possible.

        Without momentum the motion has no drift: at the rotor speeds sigma u(s), ds/dt = sigma,
        the sphere passes the same poses as at the speeds u(t), at another pace sigma. The pace
        falls from one to zero as fast as the limit of the rotors' acceleration [rad/s^2] allows,
        which a rotor that is just being reversed uses already. After the last knot it is a ramp,
        at the end of which both rotors rest. The hold exceeds no limit.
        """
        if time < self.end:
            rest = self.starting_at(time, self.at(time)) if time > self.start else self
            slowed = _slowed(rest, _SHARE * max_acceleration)
            if time > self.start:
                slowed = self.until(time).followed_by(slowed)
            return slowed.stop(slowed.end, max_acceleration)
        fastest = max(map(abs, self.speeds[-1].tolist()))
        if fastest == 0.0:
            return self
        # Rounded up to nanoseconds, as stamps are: a shorter ramp would exceed the limit.
        shortest, began = fastest / max_acceleration, self.end
        end = began + max(SHORTEST, math.ceil(shortest * NANOSECONDS) / NANOSECONDS)
        if end - began < shortest:  # on a clock that counts from 1970 a float resolves 2e-7 s
            end = math.nextafter(end, math.inf)
        times, speeds = np.append(self.times, end), np.vstack((self.speeds, np.zeros(INPUT_SIZE)))
        return FirstOrderHold._unchecked(times, speeds)

    def limited(self, max_speed: float, max_acceleration: float) -> "FirstOrderHold":
        """Return the hold with each knot, from first to last, clipped to the limits.

        They are in rad/s and rad/s^2; the first knot, the speeds in force, is not changed.
        """
        speeds, changes = self.speeds, max_acceleration * self.durations[:, None]
        before, after = speeds[:-1], speeds[1:]
        kept = (before - changes <= after) & (after <= before + changes)
        if (kept & (np.abs(after) <= max_speed)).all():
            return self
        times, rows = self._knots, speeds.tolist()
        for i in range(1, len(times)):
            reach = max_acceleration * (times[i] - times[i - 1])
            for rotor in range(INPUT_SIZE):
                last = rows[i - 1][rotor]
                wanted = min(max(rows[i][rotor], -max_speed), max_speed)
                rows[i][rotor] = min(max(wanted, last - reach), last + reach)
        return FirstOrderHold._unchecked(self.times.copy(), np.array(rows))


def _slowed(hold: FirstOrderHold, limit: float) -> FirstOrderHold:
    """Return a hold at a falling pace, up to where only a ramp is left; see `stop`."""
    times, rows = hold.times.tolist(), hold.speeds.tolist()

    def planned(time: float) -> tuple[float, float]:
        # Every command has such a stop at its end; single values are fastest in lists.
        i = bisect_right(times, time)
        if i == len(times):
            return rows[-1][0], rows[-1][1]
        share = (time - times[i - 1]) / (times[i] - times[i - 1])
        (x, y), (next_x, next_y) = rows[i - 1], rows[i]
        return x + share * (next_x - x), y + share * (next_y - y)

    reach, place, pace = limit * _STOP_SPACING, hold.start, 1.0
    first, second = rows[0]
    knots = [(first, second)]
    while (first or second) and place < hold.end:
        # A lower pace leads to a place between these two.
        x, y = planned(place + 0.5 * pace * _STOP_SPACING)
        next_x, next_y = planned(place + pace * _STOP_SPACING)
        slower = max(
            _slowest(first, x, (next_x - x) / pace, reach),
            _slowest(second, y, (next_y - y) / pace, reach),
        )
        if slower == 0.0:
            break
        slower = min(slower, pace)
        place, pace = place + 0.5 * (pace + slower) * _STOP_SPACING, slower
        x, y = planned(place)
        first, second = pace * x, pace * y
        knots.append((first, second))
    spaced: Vector = hold.start + _STOP_SPACING * np.arange(len(knots), dtype=np.float64)
    return FirstOrderHold(spaced, np.array(knots)).limited(math.inf, limit)


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
