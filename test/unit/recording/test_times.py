# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Log times and stamps of any clock become times of the run; what cannot be used is told."""

import dataclasses

import numpy as np
import pytest
from recorded_bags import START, changed, in_order, run_messages, walled_messages

from sphere_sim.recording.bag_clock import BagClock, longest_run
from sphere_sim.recording.bag_files import BagError

NOW = 1_800_000_000_000_000_000
MS, S = 1_000_000, 1_000_000_000


def clock_of(*pairs: tuple[float, float]) -> BagClock:
    """Return the clock of poses with log time since NOW and stamp, both in milliseconds."""
    return BagClock([NOW + round(log * MS) for log, _ in pairs], [round(s * MS) for _, s in pairs])


@pytest.mark.parametrize(
    ("poses", "times"),
    [
        # A simulation that is faster, then paused, then slower than real time.
        ([(0, 500), (10, 550), (20, 600), (30, 600), (60, 1000)],
         {0: 0.0, 4: 0.02, 15: 0.075, 25: 0.1, 45: 0.3, 60: 0.5}),
        # Before and after the poses both clocks run equally fast.
        ([(0, 100), (10, 200)], {-250: -0.25, 40: 0.13}),
        # The first of several poses that are logged at once counts.
        ([(10, 0), (10, 10), (10, 20), (20, 30)], {10: 0.0, 20: 0.03}),
        # The clock of the recorder is paused.
        ([(0, 0), (10, 10), *((20, 20 + 10 * i) for i in range(500))], {20: 0.02, 30: 5.02}),
    ],
)
def test_log_times_are_interpolated_between_poses(poses, times) -> None:
    clock = clock_of(*poses)
    assert clock.origin == poses[0][1] * MS
    for log, time in times.items():
        assert clock.time_of_log(NOW + log * MS) == pytest.approx(time, abs=1e-12)


PAUSED = clock_of((0, 0), (10, 10), *((20, 20 + 10 * i) for i in range(500)))
RUNNING = clock_of(*((t, t) for t in range(2_000, 8_000, 10)))


@pytest.mark.parametrize(
    ("clock", "stamp", "log", "latched", "time"),
    [
        *((PAUSED, stamp, 20, False, stamp / 1e3) for stamp in (500, 2_000, 5_010)),
        (PAUSED, 9_000, 20, False, 0.02),
        (RUNNING, 2_100, 7_500, False, 0.1),  # of the run, however late or early it is logged
        (RUNNING, 0, 4_000, True, 2.0),  # a sender without a clock
        (RUNNING, 500, 2_000, True, -1.5),  # kept by its publisher since before the recording
        (RUNNING, 9_000, 4_000, True, 2.0),  # in the future, so of another clock
        (RUNNING, 1_800_000_000_000, 4_000, True, 2.0),  # of the system clock
    ],
)
def test_plausible_stamps_are_used(clock, stamp, log, latched, time) -> None:
    found = clock.time_of_message(stamp * MS, NOW + log * MS, latched=latched)
    assert found == pytest.approx(time)


@pytest.mark.parametrize(
    ("stamps", "run"),
    [([0, 20, 10, 30], (0, 4)), ([7_000, 7_010, 0, 10, 20], (2, 5)),
     ([0, 2_000, 4_000, 10, 20], (0, 3))],
    ids=["overtaken", "last", "first"],
)
def test_restart_of_the_simulator_begins_another_run(stamps, run) -> None:
    assert longest_run([stamp * MS for stamp in stamps]) == slice(*run)


def live(entries):
    """Return entries of a robot on the system clock, by log time and stamp."""
    return [changed(entry, log=entry[2] + NOW, stamp=entry[2] + NOW)
            if hasattr(entry[3], "header") else (*entry[:2], entry[2] + NOW, entry[3])
            for entry in entries]


def restamped(entries, ending: str, stamp_of) -> list:
    """Return entries with other stamps of a topic, from its number, log time; None leaves it."""
    found, number = [], 0
    for entry in entries:
        stamp = None
        if entry[0].endswith(ending):
            stamp, number = stamp_of(number, entry[2]), number + 1
        found.append(entry if stamp is None else changed(entry, stamp=stamp))
    return found


def none(number: int, log: int) -> int:
    return 0


NO_CLOCK = "stamps are not of the clock of the poses; the log times are used"


@pytest.mark.parametrize(
    ("ending", "note"),
    [
        ("/pose", "/pose: 301 of 301 poses have the stamp 0, so that their log times"),
        ("/joint_states", f"/joint_states: 301 {NO_CLOCK}"),
        ("/active_goal", f"/controller/active_goal: 1 {NO_CLOCK}"),
    ],
)
def test_messages_without_a_stamp_have_their_log_times(read, ending, note) -> None:
    expect_log_times(read, ending, none, note)


STANDING = "the stamps of the poses do not advance as a time does, so that their log"


@pytest.mark.parametrize(
    ("ending", "note"),
    [("/pose", f"/pose: {STANDING}"), ("/joint_states", f"/joint_states: 301 {NO_CLOCK}")],
)
@pytest.mark.parametrize(
    "stamp_of",
    [
        lambda number, log: NOW + START,
        lambda number, log: log // S * S,
        lambda number, log: NOW + START + number // 3 * 30 * MS,
        lambda number, log: NOW + START + number,
        lambda number, log: 7 * S,
        lambda number, log: max(NOW + START, log // S * S - (number % 50 == 0)),
    ],
    ids=["constant", "whole seconds", "thrice", "nanoseconds", "of another clock", "jitter"],
)
def test_messages_whose_stamps_do_not_advance_have_their_log_times(
    read, ending, note, stamp_of
) -> None:
    expect_log_times(read, ending, stamp_of, note)


def expect_log_times(read, ending: str, stamp_of, note: str) -> None:
    expected = read(live(run_messages()))
    run = read(restamped(live(run_messages()), ending, stamp_of))
    assert dataclasses.asdict(run.metrics()) == pytest.approx(
        dataclasses.asdict(expected.metrics()), nan_ok=True, rel=1e-6, abs=1e-6
    )
    for name in ("times", "states"):
        np.testing.assert_allclose(getattr(run, name), getattr(expected, name), atol=1e-6)
    (told,) = run.notes
    assert told.startswith(note)


@pytest.mark.parametrize(
    "stamps",
    [
        # Simulated time that is paused, a hundred times slower, and as fast as possible.
        [START + max(0, i - 200) * 10 * MS for i in range(301)],
        [START + i * MS // 10 for i in range(301)],
        [START + i * S for i in range(301)],
        [START + i // 2 * 20 * MS for i in range(301)],  # twice
    ],
    ids=["paused", "slow", "fast", "twice"],
)
def test_stamps_of_simulated_time_are_used(read, stamps) -> None:
    entries = restamped(run_messages(), "/pose", lambda number, log: stamps[number])
    first = next(entry for entry in entries if entry[0] == "/pose")
    # While simulated time is paused, the pose of that instant is repeated.
    run = read(changed((*entry[:3], first[3]), log=entry[2])
               if entry[0] == "/pose" and entry[3].header.stamp == first[3].header.stamp else entry
               for entry in entries)
    assert run.times == pytest.approx((np.unique(stamps) - stamps[0]) / S)
    assert not any("stamps of the poses" in note for note in run.notes)


FAR = "were ignored, whose stamps are far from those around them"


@pytest.mark.parametrize(
    ("stamp", "note"),
    [
        (lambda number, log: 0 if number % 3 == 1 else None,
         "/pose: 100 poses with the stamp 0 were ignored"),
        (lambda number, log: 5 * S if number % 3 == 1 else None, f"/pose: 100 poses {FAR}"),
        (lambda number, log: log + 10**12 if number == 160 else None, f"/pose: 1 poses {FAR}"),
        (lambda number, log: log - 10**12 if number == 160 else None, f"/pose: 1 poses {FAR}"),
        (lambda number, log: log - 10**12 if number == 0 else None, f"/pose: 1 poses {FAR}"),
        (lambda number, log: log + 10**12 if number == 300 else None, f"/pose: 1 poses {FAR}"),
    ],
    ids=["0", "simulated", "later", "earlier", "first", "last"],
)
def test_poses_with_other_stamps_are_ignored_and_told(read, whole, stamp, note) -> None:
    run = read(restamped(live(run_messages()), "/pose", stamp))
    assert run.notes == (note,)
    assert len(run.times) == 301 - int(note.split()[1])
    settled = whole.metrics().settle_time_s
    assert run.metrics().settle_time_s == pytest.approx(settled, abs=0.011)
    assert run.times[-1] == pytest.approx(3.0, abs=0.011)


def test_stamp_0_is_a_time_where_simulated_time_begins_and_else_needs_a_log_time(read) -> None:
    run = read(restamped(run_messages(), "/pose", lambda number, log: log - START))
    assert len(run.times) == 301 and run.times[-1] == pytest.approx(3.0)
    entries = restamped(live(walled_messages(0.1)), "/floor", none)
    run = read(entries)
    assert run.floors.times == pytest.approx([0.0], abs=0.03)
    assert f"/controller/floor: 1 {NO_CLOCK}" in run.notes
    entries = [changed(entry, log=START) for entry in restamped(run_messages(), "/pose", none)]
    with pytest.raises(BagError, match="/pose: none of the poses has a stamp or a log"):
        read(in_order(*entries))


def test_poses_of_one_instant_on_both_clocks_are_one_pose(read) -> None:
    """As when simulated time is paused and somebody else sends other poses."""
    entries = restamped(run_messages(), "/pose", lambda number, log: START)
    run = read(in_order(*(changed(entry, log=START) for entry in entries)))
    assert len(run.times) == 1 and not any(note.startswith("/pose") for note in run.notes)
