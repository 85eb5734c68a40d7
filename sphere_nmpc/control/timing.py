# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Control time: pace and jumps of its clock, and missed sampling instants."""

from collections import deque

from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.reporting.recent import Recent

MOST_AHEAD = 0.5
"""How far ahead of its clock a command may begin [s]; a smaller step of the clock is no jump."""
_PACE_WINDOW, _MIN_PACE_TIME = 0.5, 1e-2
"""Wall time over which the pace is measured, and that at least needed [s]."""
_MAX_CATCH_UP = 3.0
"""Excess over the measured pace up to which a simulated clock does not jump, in paces of at least
1: on a busy machine simulator and controller run by turns."""
_STEADY_AFTER = 0.2
"""Wall time without a jump after which the clock is steady again, and without progress of control
time that counts as a pause [s]."""
_COUNT_EVERY = 1.0
"""Least wall time between two readings of the numbers of samples [s]."""
_COUNTED_INTERVALS = 5
"""Intervals between readings over which the share is taken."""
_REPORTED_SHARE = 0.05
"""Share of missed instants from which on it is reported."""


class ClockWatch:
    """Measurement of the pace of control time, and detector of its jumps.

    A simulated clock jumps when it goes back, or ahead by more than its pace explains; the system
    clock when it departs from the steady clock.

    Parameters
    ----------
    simulated : bool
        Whether the pace of control time has to be measured; otherwise it is 1.
    has_pace : bool, optional
        Whether control time advances with the wall clock. In lockstep it does not: it jumps back
        only, and is steady again at once.
    """

    def __init__(self, simulated: bool, has_pace: bool = True) -> None:
        self._simulated = simulated
        self._has_pace = has_pace
        self._readings: deque[tuple[float, float]] = deque()
        self._last: tuple[float, float] | None = None
        self._read_at = float("-inf")
        self.pace = self._known_pace = None if simulated else 1.0
        """Control time over wall time; None until it has been measured for long enough."""
        self.is_steady = True
        """Whether the clock has not jumped lately."""
        self._jumped_at = float("-inf")
        self._before = (0.0, 0.0)
        self._held_up: tuple[float, float, float] | None = None
        self.step = 0.0
        """Control time after the last jump less that before it [s]."""
        self.has_returned = False
        """Whether the clock has become steady within `MOST_AHEAD` of what it would show without
        jumps."""

    def read(self, now: float, wall: float) -> bool:
        """Record that control time is `now` [s] when the steady clock shows `wall` [s].

        A standstill and a jump restart the measurement of the pace; after a standstill it begins
        when control time has advanced.

        Returns
        -------
        bool
            Whether the clock has jumped, or has become steady again after jumps.
        """
        last, read_at = self._last, self._read_at
        jumped = last is not None and self._has_jumped(last[0], now, wall)
        if jumped and last is not None:
            self.step = now - last[0]
            self.has_returned = False
            if self.is_steady:
                self._before = (last[0], read_at)
            self._jumped_at, self.is_steady = wall, not self._has_pace
            self._readings.clear()
        self._measure(now, wall)
        if jumped or self.is_steady or wall < self._jumped_at + _STEADY_AFTER:
            return jumped
        self.is_steady = True
        self.has_returned = abs(now - self.expected(wall)) <= MOST_AHEAD
        return True

    def expected(self, wall: float) -> float:
        """Return the control time [s] that a clock which jumps would show without its jumps.

        `wall` is what the steady clock shows [s].
        """
        then, wall_then = self._before
        return then + (self._known_pace or 0.0) * (wall - wall_then)

    def _has_jumped(self, then: float, now: float, wall: float) -> bool:
        """Return whether the clock has jumped since the last reading, which was `then` [s]."""
        read_at = self._read_at
        jumped = self._is_jump(then, read_at, now, wall)
        if (wall - read_at) * max(1.0, self._known_pace or 0.0) > MOST_AHEAD:
            # A process that was held up may read an old message first.
            self._held_up = then, read_at, wall
        elif jumped and now > then and self._held_up is not None:
            before, wall_before, ended = self._held_up
            is_recent = wall < ended + _STEADY_AFTER
            return not is_recent or self._is_jump(before, wall_before, now, wall)
        return jumped

    def _is_jump(self, then: float, wall_then: float, now: float, wall: float) -> bool:
        """Return whether the clock cannot have run from `then` to `now` in this wall time."""
        step, passed, pace = now - then, wall - wall_then, self._known_pace
        if not self._simulated:
            return abs(step - passed) > MOST_AHEAD
        if step < 0.0 or pace is None or not self._has_pace:
            return step < 0.0
        return step > MOST_AHEAD + (pace + _MAX_CATCH_UP * max(1.0, pace)) * passed

    def _measure(self, now: float, wall: float) -> None:
        self._read_at, readings = wall, self._readings
        if self._last is not None and now == self._last[0]:
            if wall - self._last[1] >= _STEADY_AFTER:
                readings.clear()
                self.pace = None if self._simulated else 1.0
            return
        self._last = (now, wall)
        readings.append((now, wall))
        while wall - readings[0][1] > _PACE_WINDOW and len(readings) > 1:
            readings.popleft()
        if self._simulated:
            then, wall_then = readings[0]
            elapsed = wall - wall_then
            self.pace = (now - then) / elapsed if elapsed >= _MIN_PACE_TIME else None
            self._known_pace = self.pace or self._known_pace


class MissedSamples:
    """Monitor of missed sampling instants; a single gap, as at a slow start, does not count."""

    def __init__(self) -> None:
        self._last: tuple[float, int, int] | None = None
        self._shares, self._spans = Recent(_COUNTED_INTERVALS), Recent(_COUNTED_INTERVALS)
        self.share = 0.0
        """Share of the instants missed lately; 0 below `_REPORTED_SHARE`, and
        until there are some in each interval."""

    def faults(self, period: float) -> list[Condition]:
        """Return the fault of instants missed at a control period [s]; empty without."""
        if not self.share:
            return []
        return [Condition(
            Kind.MISSED_SAMPLES,
            f"given {100.0 * self.share:.3g} % of the sampling instants of the last "
            f"{sum(self._spans):.0f} s without a plan, at {1.0 / period:.4g} Hz, expected none; a "
            "lower control_rate, thread_priority: 1 or a free processor core helps",
        )]

    def read(self, wall: float, used: int, missed: int) -> None:
        """Take the numbers of instants with and without a plan so far, at wall time `wall` [s]."""
        then, used_then, missed_then = self._last or (wall, used, missed)
        if self._last is not None and wall < then + _COUNT_EVERY:
            return
        if self._last is not None:
            gained = missed - missed_then
            self._shares.append(gained / max(1, gained + used - used_then))
            self._spans.append(wall - then)
        self._last = (wall, used, missed)
        lasts = bool(self.share) or (self._shares.is_full and self._shares.quantile(0.0) > 0.0)
        self.share = self._shares.mean if lasts and self._shares.mean >= _REPORTED_SHARE else 0.0
