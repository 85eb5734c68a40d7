# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Pace and jumps of control time, missed samples, and the newest values of a stream."""

import math

import numpy as np
import pytest

from sphere_nmpc.control.timing import ClockWatch, MissedSamples
from sphere_nmpc.reporting.recent import Recent

SPACING = 0.01


def read(watch: ClockWatch, now: float, wall: float, duration: float, pace: float = 1.0) -> int:
    """Let a clock run that shows `now` at `wall` [s]; return how often something has changed."""
    return sum(watch.read(now + pace * t, wall + t) for t in np.arange(0.0, duration, SPACING))


def running(pace: float = 1.0, simulated: bool = True) -> ClockWatch:
    """Return the watch of a clock that has shown `pace` s at 1 s of wall time, for a second."""
    watch = ClockWatch(simulated)
    assert read(watch, 0.0, 0.0, 1.0, pace) == 0
    return watch


def test_pace_is_measured_for_a_while_and_anew_after_a_pause() -> None:
    watch = ClockWatch(simulated=True)
    watch.read(0.0, 7.0)
    watch.read(0.045, 7.009)
    assert watch.pace is None
    watch.read(0.1, 7.02)
    assert watch.pace == pytest.approx(5.0)
    watch.read(0.1, 7.05)
    assert watch.pace == pytest.approx(5.0), "the same instant again"
    for wall in (7.1, 7.3):
        assert not watch.read(0.1, wall)
    assert watch.pace is None
    watch.read(0.2, 7.32)
    assert watch.pace is None, "how long before the reading time went on is unknown"
    watch.read(0.3, 7.34)
    assert watch.pace == pytest.approx(5.0) and watch.is_steady
    assert read(watch, 0.31, 7.35, 0.6, pace=4.0) == 0
    assert watch.pace == pytest.approx(4.0, rel=0.01), "half a second later"
    assert ClockWatch(simulated=False).pace == 1.0


@pytest.mark.parametrize("pace", [0.5, 1.0, 20.0])
def test_old_message_that_is_read_first_after_a_hold_up_makes_no_jump(pace: float) -> None:
    watch = running(pace)
    assert not watch.read(1.002 * pace, 4.0), "what had arrived before"
    assert not watch.read(4.001 * pace, 4.001)
    assert watch.is_steady
    assert watch.read(64.0 * pace, 4.002), "which is more than it can have missed"
    watch = running(pace)
    assert not watch.read(1.002 * pace, 4.0) and read(watch, 1.01 * pace, 4.01, 0.3, pace) == 0
    assert watch.read(4.31 * pace, 4.31), "too late to be a message that has waited"


@pytest.mark.parametrize("simulated", [True, False])
@pytest.mark.parametrize("step", [3600.0, 0.6, -0.6, -3600.0])
def test_jump_is_told_at_once_and_over_when_the_clock_has_been_steady(
    simulated: bool, step: float
) -> None:
    watch = running(simulated=simulated)
    assert watch.read(1.0 + step, 1.0)
    assert not watch.is_steady
    assert watch.step == pytest.approx(step + SPACING)
    assert read(watch, 1.1 + step, 1.1, 0.095) == 0 and not watch.is_steady
    assert read(watch, 1.2 + step, 1.2, 0.095) == 1 and watch.is_steady
    assert not watch.has_returned
    assert watch.pace == pytest.approx(1.0), "the jump is not part of the pace"


@pytest.mark.parametrize("simulated", [True, False])
def test_clock_that_jumps_and_comes_back_has_returned(simulated: bool) -> None:
    watch = running(simulated=simulated)
    for wall in (1.0, 1.02, 1.04):  # one forged message after another, among the true ones
        assert watch.read(3600.0, wall)
        assert watch.read(wall + 0.01, wall + 0.01)
    assert read(watch, 1.06, 1.06, 0.25) == 1
    assert watch.is_steady and watch.has_returned
    watch.read(-50.0, 2.0)
    assert not watch.is_steady and not watch.has_returned


def reported(missed_in: list[int]) -> list[float]:
    """Return the share after each second, of whose 500 instants so many were missed."""
    monitor, used, missed = MissedSamples(), 0, 0
    monitor.read(0.0, used, missed)
    shares = []
    for second, count in enumerate(missed_in, start=1):
        used, missed = used + max(0, 500 - count), missed + count
        for part in (0.0, 0.25, 0.5, 0.75):
            monitor.read(second + part, used, missed)
        shares.append(monitor.share)
    return shares


def test_misses_are_reported_after_five_seconds_and_until_they_are_over() -> None:
    shares = reported([133] * 10 + [0] * 10)
    assert shares[:4] == [0.0] * 4
    assert shares[4:10] == pytest.approx([133 / 500] * 6)
    assert shares[10] > 0.0 and shares[-6:] == [0.0] * 6
    varying = reported([100] * 6 + [0, 30, 20, 100, 0, 40, 50, 0, 60, 20])
    assert all(varying[4:]), "one report"
    # Neither a slow start, nor a clock that is set ahead, nor two per cent.
    for few in ([900, 700, 300, 200, *[0] * 16], [0] * 10 + [1_800_000], [10] * 20):
        assert not any(reported(few))


def test_mean_and_quantiles_are_those_of_the_newest_values_that_are_known() -> None:
    recent, values = Recent(5), np.random.default_rng(1).normal(size=9)
    assert math.isnan(recent.mean) and math.isnan(recent.quantile(0.5)) and not recent.is_full
    recent.extend(values)
    assert recent.is_full and recent.mean == pytest.approx(np.mean(values[4:]), abs=1e-15)
    for share in (0.0, 0.3, 0.5, 1.0):
        expected = np.quantile(values[4:], share)
        assert recent.quantile(share) == pytest.approx(expected, abs=1e-15)
    recent.extend((math.nan, 2.0, 3.0, 2.5, math.nan))
    assert (recent.quantile(0.0), recent.quantile(1.0)) == (2.0, 3.0)
