# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Pace and jumps of control time."""

import numpy as np
import pytest

from sphere_nmpc.control.clock_watch import ClockWatch

SPACING = 0.01


def read(watch: ClockWatch, now: float, wall: float, duration: float, pace: float = 1.0) -> int:
    """Let a clock run that shows `now` at `wall` [s]; return how often something has changed."""
    return sum(watch.read(now + pace * t, wall + t) for t in np.arange(0.0, duration, SPACING))


def running(pace: float = 1.0, simulated: bool = True) -> ClockWatch:
    """Return the watch of a clock that shows `pace` s at 1 s of wall time."""
    watch = ClockWatch(simulated)
    assert read(watch, 0.0, 0.0, 1.0, pace) == 0
    return watch


def test_pace_is_unknown_until_it_has_been_measured_for_a_while() -> None:
    watch = ClockWatch(simulated=True)
    assert watch.pace is None
    watch.read(0.0, 7.0)
    watch.read(0.045, 7.009)
    assert watch.pace is None
    watch.read(0.1, 7.02)
    assert watch.pace == pytest.approx(5.0)
    assert ClockWatch(simulated=False).pace == 1.0


def test_new_pace_is_known_half_a_second_later_and_is_no_jump() -> None:
    watch = running(1.0)
    assert read(watch, 1.0, 1.0, 0.6, pace=4.0) == 0
    assert watch.pace == pytest.approx(4.0, rel=0.01)


def test_pause_is_no_pace_and_no_jump() -> None:
    watch = running(5.0)
    last = 5.0 * (1.0 - SPACING)
    for wall in (1.2, 1.4, 1.6):
        assert not watch.read(last, wall)
    assert watch.pace is None
    watch.read(5.1, 1.62)
    assert watch.pace is None, "how long before the reading time went on is unknown"
    watch.read(5.2, 1.64)
    assert watch.pace == pytest.approx(5.0)
    assert watch.is_steady


def test_second_reading_of_the_same_instant_counts_for_nothing() -> None:
    watch = running()
    pace = watch.pace
    watch.read(1.0 - SPACING, 1.05)
    assert watch.pace == pace


@pytest.mark.parametrize("simulated", [True, False])
@pytest.mark.parametrize("pace", [1.0, 20.0])
def test_process_that_was_held_up_finds_no_jump(simulated: bool, pace: float) -> None:
    pace = pace if simulated else 1.0
    watch = running(pace, simulated)
    assert read(watch, 61.0 * pace, 61.0, 1.0, pace) == 0


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
@pytest.mark.parametrize("step", [3600.0, 2.0, 1.0, 0.6, -0.6, -2.0, -3600.0])
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


def test_two_clocks_on_one_topic_are_never_steady() -> None:
    watch = running()
    for wall in np.arange(1.0, 3.0, SPACING):
        watch.read(wall, wall)
        watch.read(wall + 5.0, wall + 0.4 * SPACING)
        assert not watch.is_steady


def test_clock_in_lockstep_may_wait_and_hurry_and_begins_again_at_once() -> None:
    watch = ClockWatch(simulated=True, has_pace=False)
    walls = np.arange(0.0, 1.0, SPACING)
    assert not any(watch.read(now, wall) for now, wall in zip(walls**4, walls, strict=True))
    assert not watch.read(30.0, 1.001)
    assert watch.read(0.0, 1.002)
    assert watch.is_steady and not watch.has_returned
    assert not watch.read(0.25, 1.003)
