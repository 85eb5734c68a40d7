# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Progress of simulated time: real-time factor, pauses, single steps and lockstep."""

import math

from sphere_nmpc.quantities import NANOSECONDS

_CATCH_UP_SPACING = 0.5
"""Smallest spacing of two instants while catching up, over the nominal one."""
_LARGEST_DELAY = 0.1
"""Delay [s, wall] beyond which lost time is given up rather than caught up."""
_SLOW = 0.95
"""Share of the wanted real-time factor below which the machine counts as too slow."""


class SimulatedClock:
    """Clock of the simulation: how long to wait [s, steady clock] before time [ns] advances.

    On a machine that is too slow time is lost, rather than caught up in a burst that no
    controller can follow; `achieved` returns the real-time factor that was achieved.

    `pose_period` and `sample_period` are the spacings of the instants at which something is
    published, and of sampling instants [ns]. `real_time_factor` is simulated over wall time; 0 is
    as fast as possible. In `lockstep` time stops at each sampling instant until its command has
    arrived, at most for `lockstep_timeout` [s, wall]. A clock that `keeps_up` catches up lost time
    in one step: the system clock also advances while the simulating process is delayed.
    """

    def __init__(
        self, pose_period: int, sample_period: int, real_time_factor: float = 1.0,
        lockstep: bool = False, lockstep_timeout: float = 5.0, paused: bool = False,
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
        """The instant [ns] whose command is awaited, None while time runs."""
        self.timeouts = 0
        """Number of waits in lockstep that timed out."""
        self.lost = 0.0
        """Wall time that was given up [s]."""
        self._wait_start: float | None = None
        self._stop_at: int | None = None
        self.restart(0, 0.0)
        self._measured_from = (0, 0.0)

    @property
    def stops(self) -> bool:
        """Whether time is stopped, or will be at the end of a step."""
        return self.paused or self._stop_at is not None

    def next_sample(self, now: int) -> int:
        """Return the sampling instant after `now` [ns]."""
        return (now // self._sample_period + 1) * self._sample_period

    def upcoming(self, now: int) -> int:
        """Return the instant after `now` at which something is published [ns]."""
        return min((now // self._pose_period + 1) * self._pose_period, self.next_sample(now))

    def due(self, now: int, wall: float) -> int:
        """Return the instant to advance to from `now` [ns] when the steady clock shows `wall` [s].

        That is the upcoming one, or with `keeps_up` the newest that has passed.
        """
        instant = self.upcoming(now)
        if not self._keeps_up:
            return instant
        start, wall_then = self._anchor
        passed = start + round((wall - wall_then) * self._factor * NANOSECONDS)
        return max(instant, passed // self._pose_period * self._pose_period)

    def restart(self, now: int, wall: float) -> None:
        """Measure time from `now` [ns] and `wall` [s] on, as after a pause."""
        self._anchor = (now, wall)
        self._last = (now, wall)

    def set_pace(self, real_time_factor: float, now: int, wall: float) -> None:
        """Continue with another real-time factor."""
        self._factor = real_time_factor
        self.restart(now, wall)

    def pause(self) -> None:
        """Stop time; `advanced` may still be called for an instant that was already begun."""
        self.paused = True
        self._stop_at = None

    def resume(self, now: int, wall: float) -> None:
        """Let time advance; in lockstep a sampling instant waits for a command sent afterwards."""
        self.paused = False
        self._stop_at = None
        self.restart(now, wall)
        self._hold_at_sample(now, wall)

    def step(self, now: int, wall: float) -> int:
        """Let time advance to the next sampling instant and pause there; return it [ns]."""
        self.resume(now, wall)
        self._stop_at = self.next_sample(now)
        return self._stop_at

    def set_sample_period(self, sample_period: int, wall: float) -> None:
        """Continue with sampling instants of another spacing [ns]: that of the controller.

        A command for an instant that is no longer one of them is not awaited, as none is sent.
        """
        self._sample_period = sample_period
        now, _ = self._last
        if self._stop_at is not None:
            self._stop_at = self.next_sample(now)
        if self.awaited is not None and self.awaited % sample_period:
            self.awaited = None
            self.restart(now, wall)

    def run_freely(self, wall: float) -> None:
        """Leave lockstep; a command that is awaited is so no longer."""
        self.lockstep = False
        if self.awaited is not None:
            self.command_received(self.awaited, wall)

    def command_received(self, stamp: int, wall: float) -> None:
        """Record the arrival of a command for the instant `stamp` [ns]."""
        if stamp == self.awaited:
            self.awaited = None
            self.restart(stamp, wall)

    def wait(self, now: int, wall: float, controller_found: bool = True) -> float:
        """Return how long to wait before time advances from `now` [ns]; 0 if it is due.

        Without a node that sends commands lockstep waits without limit.
        """
        if self.paused:
            return math.inf
        if self.awaited is not None:
            if not controller_found:
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

    def advanced(self, now: int, wall: float) -> None:
        """Record that simulated time has reached `now` [ns]."""
        late = wall - self._ideal(now)
        self._last = (now, wall)
        if self._factor > 0.0 and late > _LARGEST_DELAY and not self._keeps_up:
            self.lost += late
            self.restart(now, wall)
        if self._stop_at is not None and now >= self._stop_at:
            self.pause()
        else:
            self._hold_at_sample(now, wall)

    def achieved(self, now: int, wall: float) -> float:
        """Return simulated over wall time since the last call; 0 while time is stopped."""
        then, wall_then = self._measured_from
        self._measured_from = (now, wall)
        return (now - then) / NANOSECONDS / max(wall - wall_then, 1e-9)

    def is_slow(self, achieved: float) -> bool:
        """Return whether a real-time factor that was achieved is less than the one to keep."""
        return not self.lockstep and achieved < _SLOW * self._factor

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
        soonest = wall + _CATCH_UP_SPACING * (instant - last) / NANOSECONDS / self._factor
        return max(self._ideal(instant), soonest)
