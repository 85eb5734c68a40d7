# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Log times and stamps of any clock become times of the run."""

import pytest

from sphere_sim.recording.bag_clock import BagClock, longest_run

NOW = 1_800_000_000_000_000_000
MS = 1_000_000


def clock_of(*pairs: tuple[float, float]) -> BagClock:
    """Return the clock of poses with log time since NOW and stamp, both in milliseconds."""
    return BagClock([NOW + round(log * MS) for log, _ in pairs], [round(s * MS) for _, s in pairs])


def logged(clock: BagClock, log: float) -> float:
    return clock.time_of_log(NOW + round(log * MS))


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
    ],
)
def test_log_times_are_interpolated_between_poses(poses, times) -> None:
    clock = clock_of(*poses)
    assert clock.origin == poses[0][1] * MS
    for log, time in times.items():
        assert logged(clock, log) == pytest.approx(time, abs=1e-12)


def test_stamps_are_used_while_the_clock_of_the_recorder_is_paused() -> None:
    clock = clock_of((0, 0), (10, 10), *((20, 20 + 10 * i) for i in range(500)))
    assert logged(clock, 20) == pytest.approx(0.02) and logged(clock, 30) == pytest.approx(5.02)
    for stamp in (500, 2_000, 5_010):
        assert clock.time_of_message(stamp * MS, NOW + 20 * MS) == stamp / 1e3
    assert clock.time_of_message(9_000 * MS, NOW + 20 * MS) == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("stamp", "log", "latched", "time"),
    [
        (2_100, 7_500, False, 0.1),  # of the run, however late or early it is logged
        (0, 4_000, True, 2.0),  # a sender without a clock
        (500, 2_000, True, -1.5),  # kept by its publisher since before the recording
        (9_000, 4_000, True, 2.0),  # in the future, so of another clock
        (1_800_000_000_000, 4_000, True, 2.0),  # of the system clock
    ],
)
def test_plausible_stamps_are_used(stamp, log, latched, time) -> None:
    clock = clock_of(*((t, t) for t in range(2_000, 8_000, 10)))
    found = clock.time_of_message(stamp * MS, NOW + log * MS, latched=latched)
    assert found == pytest.approx(time)


def test_restart_of_the_simulator_begins_another_run() -> None:
    for stamps, run in (
        ([0, 20, 10, 30], (0, 4)),  # overtaken
        ([7_000, 7_010, 0, 10, 20], (2, 5)),
        ([0, 2_000, 4_000, 10, 20], (0, 3)),
    ):
        assert longest_run([stamp * MS for stamp in stamps]) == slice(*run)
