# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""When simulated time may go on: its pace, pauses, single steps and the waits of lockstep."""

import math

NANOSECONDS = 1_000_000_000
_MAKE_UP = 0.5
"""Smallest spacing of two instants, over the one that was asked for, while making up lateness."""
_LATEST = 0.1
"""Lateness [s] beyond which lost time is given up rather than made up."""


class Timekeeper:
    """Say how long to wait, on a steady wall clock [s], before simulated time [ns] goes on.

    A machine that is too slow loses time instead of catching up in a burst, for which no
    controller is prepared; `achieved` tells the truth about it.

    Parameters
    ----------
    pose_period, sample_period : int
        Spacing of the instants at which something is published, and of sample instants [ns].
    real_time_factor : float
        Simulated over wall time; 0 is as fast as possible.
    lockstep : bool
        Whether each sample instant waits for its answer.
    lockstep_timeout : float
        Wall time after which such a wait is given up [s].
    paused : bool
        Whether time stands still at first.
    keeps_up : bool
        Whether lost time is made up at once: a world on the system clock runs on, whatever
        becomes of the process that simulates it.
    """

    def __init__(
        self,
        pose_period: int,
        sample_period: int,
        real_time_factor: float = 1.0,
        lockstep: bool = False,
        lockstep_timeout: float = 5.0,
        paused: bool = False,
        keeps_up: bool = False,
    ) -> None:
        self._pose_period = pose_period
        self._sample_period = sample_period
        self._factor = real_time_factor
        self._keeps_up = keeps_up
        self.lockstep = lockstep
        self._timeout = lockstep_timeout
        self.paused = paused
        self.awaited: int | None = None
        """The instant [ns] whose answer is awaited, None while time runs."""
        self.timeouts = 0
        """Waits that were given up."""
        self.lost = 0.0
        """Wall time that could not be made up [s]."""
        self._wait_start: float | None = None
        self._stop_at: int | None = None
        self.restart(0, 0.0)
        self._measured_from = (0, 0.0)

    def next_sample(self, now: int) -> int:
        """Return the sample instant after `now` [ns]."""
        return (now // self._sample_period + 1) * self._sample_period

    def upcoming(self, now: int) -> int:
        """Return the instant after `now` at which something is published [ns]."""
        return min((now // self._pose_period + 1) * self._pose_period, self.next_sample(now))

    def due(self, now: int, wall: float) -> int:
        """Return the instant to advance to from `now` [ns] when the steady clock shows `wall` [s].

        That is the upcoming one, or the newest that has passed where time is made up.
        """
        instant = self.upcoming(now)
        if not self._keeps_up:
            return instant
        start, wall_then = self._anchor
        passed = start + round((wall - wall_then) * self._factor * NANOSECONDS)
        return max(instant, passed // self._pose_period * self._pose_period)

    def restart(self, now: int, wall: float) -> None:
        """Count time from here on, as after a pause."""
        self._anchor = (now, wall)
        self._last = (now, wall)

    def set_pace(self, real_time_factor: float, now: int, wall: float) -> None:
        """Go on at another pace."""
        self._factor = real_time_factor
        self.restart(now, wall)

    def pause(self) -> None:
        """Let time stand still; `ran` may still be called for an instant already begun."""
        self.paused = True
        self._stop_at = None

    def resume(self, now: int, wall: float) -> None:
        """Let time go on; in lockstep a sample instant waits for an answer given from now on."""
        self.paused = False
        self._stop_at = None
        self.restart(now, wall)
        self._hold_at_sample(now, wall)

    def step(self, now: int, wall: float) -> int:
        """Let time go on to the next sample instant and pause there; return it [ns]."""
        self.resume(now, wall)
        self._stop_at = self.next_sample(now)
        return self._stop_at

    def answer(self, stamp: int, wall: float) -> None:
        """Take note of a command for the instant `stamp` [ns]."""
        if stamp == self.awaited:
            self.awaited = None
            self.restart(stamp, wall)

    def wait(self, now: int, wall: float, partner: bool = True) -> float:
        """Return how long to wait before going on from `now` [ns]; 0 when it is time.

        Parameters
        ----------
        now : int
            Simulated time [ns].
        wall : float
            Steady clock [s].
        partner : bool, optional
            Whether anybody is there who could answer; without, a wait in lockstep has no end.
        """
        if self.paused:
            return math.inf
        if self.awaited is not None:
            if not partner:
                self._wait_start = None
                return math.inf
            if self._wait_start is None:
                self._wait_start = wall
            left = self._wait_start + self._timeout - wall
            if left > 0.0:
                return left
            self.timeouts += 1
            self.restart(self.awaited, wall)
            self.awaited = None
        return max(0.0, self._due(self.upcoming(now)) - wall)

    def ran(self, now: int, wall: float) -> None:
        """Take note that simulated time has reached `now` [ns]."""
        late = wall - self._ideal(now)
        self._last = (now, wall)
        if self._factor > 0.0 and late > _LATEST and not self._keeps_up:
            self.lost += late
            self.restart(now, wall)
        if self._stop_at is not None and now >= self._stop_at:
            self.pause()
        else:
            self._hold_at_sample(now, wall)

    def achieved(self, now: int, wall: float) -> float:
        """Return simulated over wall time since this was last asked; 0 while nothing moves."""
        then, wall_then = self._measured_from
        self._measured_from = (now, wall)
        return (now - then) / NANOSECONDS / max(wall - wall_then, 1e-9)

    def _hold_at_sample(self, now: int, wall: float) -> None:
        if self.lockstep and now % self._sample_period == 0:
            self.awaited = now
            self._wait_start = wall

    def _ideal(self, instant: int) -> float:
        if self._factor <= 0.0:
            return -math.inf
        start, wall = self._anchor
        return wall + (instant - start) / NANOSECONDS / self._factor

    def _due(self, instant: int) -> float:
        if self._factor <= 0.0:
            return -math.inf
        if self._keeps_up:
            return self._ideal(instant)
        last, wall = self._last
        soonest = wall + _MAKE_UP * (instant - last) / NANOSECONDS / self._factor
        return max(self._ideal(instant), soonest)
