# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Log times become times of the run, whatever clock they are of and however that one runs."""

import numpy as np
import pytest

from sphere_sim.recording.bag_clock import BagClock, longest_run

NOW = 1_800_000_000_000_000_000
MS = 1_000_000


def clock_of(*pairs: tuple[float, float]) -> BagClock:
    """Return a clock of poses with log time since NOW and stamp, both in milliseconds."""
    return BagClock([NOW + round(log * MS) for log, _ in pairs], [round(s * MS) for _, s in pairs])


def heard(clock: BagClock, log: float) -> float:
    return clock.heard(NOW + round(log * MS))


def test_a_simulation_faster_than_real_time_is_interpolated() -> None:
    clock = clock_of((0, 500), (10, 550), (20, 600), (30, 600), (60, 1000))
    assert clock.origin == 500 * MS
    for log, time in ((0, 0.0), (4, 0.02), (15, 0.075), (25, 0.1), (45, 0.3), (60, 0.5)):
        assert heard(clock, log) == pytest.approx(time, abs=1e-12)


def test_time_that_stands_still_stands_still() -> None:
    clock = clock_of(*((10 * i, 0) for i in range(100)), (1000, 10))
    assert heard(clock, 123) == heard(clock, 987) == 0.0
    assert heard(clock, 995) == pytest.approx(0.005)


def test_outside_the_poses_both_clocks_run_alike() -> None:
    clock = clock_of((0, 100), (10, 200))
    assert heard(clock, -250) == pytest.approx(-0.25)
    assert heard(clock, 40) == pytest.approx(0.13)


def test_a_single_pose_is_enough() -> None:
    assert heard(clock_of((0, 100)), 30) == pytest.approx(0.03)


def test_poses_out_of_order_do_not_turn_time_back() -> None:
    rng = np.random.default_rng(1)
    stamps = np.arange(0, 5000, 10)
    logs = 0.2 * stamps + rng.exponential(5.0, stamps.size)  # latency of several periods
    assert np.any(np.diff(logs) < 0)
    shuffled = rng.permutation(stamps.size)
    clock = clock_of(*zip(logs[shuffled], stamps[shuffled], strict=True))
    grid = np.linspace(-100, 1200, 2000)
    times = np.array([heard(clock, log) for log in grid])
    assert np.all(np.diff(times) >= -1e-12)  # the rounding of an interpolation
    inside = (grid > 50) & (grid < 1000)
    # A latency of 5 ms in the mean, at five times real time, and the longest of the last few.
    assert np.max(np.abs(times[inside] - 5e-3 * grid[inside])) < 0.15


def test_poses_logged_at_once_count_from_the_first() -> None:
    clock = clock_of((10, 0), (10, 10), (10, 20), (20, 30))
    assert heard(clock, 10) == 0.0 and heard(clock, 20) == pytest.approx(0.03)


def test_stamps_are_believed_where_the_recorders_clock_stood_still() -> None:
    clock = clock_of((0, 0), (10, 10), *((20, 20 + 10 * i) for i in range(500)))
    assert heard(clock, 20) == pytest.approx(0.02) and heard(clock, 30) == pytest.approx(5.02)
    for stamp in (500, 2_000, 5_010):
        assert clock.told(stamp * MS, NOW + 20 * MS) == stamp / 1e3
    assert clock.told(9_000 * MS, NOW + 20 * MS) == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("stamp", "log", "kept", "time"),
    [
        (4_000, 4_040, False, 2.0),  # of the poses' clock, on its way for a while
        (4_010, 4_000, False, 2.01),  # before the pose of its own time
        (0, 4_000, False, 2.0),  # a sender without a clock
        (0, 4_000, True, 2.0),
        (500, 2_000, True, -1.5),  # kept since before the recording
        (500, 4_000, False, 2.0),  # not kept, so of a clock of its own
        (9_000, 4_000, True, 2.0),  # nothing comes before it was sent
        (1_800_000_000_000, 4_000, True, 2.0),  # of the system's clock
    ],
)
def test_a_stamp_is_believed_where_it_can_be_of_the_poses_clock(stamp, log, kept, time) -> None:
    clock = clock_of(*((t, t) for t in range(2_000, 8_000, 10)))
    assert clock.told(stamp * MS, NOW + log * MS, kept=kept) == pytest.approx(time)


def test_a_stamp_of_zero_is_time_zero_where_time_begins() -> None:
    clock = clock_of((0, 0), (300, 0), (310, 10), (320, 20))
    assert clock.told(0, NOW + 315 * MS) == 0.0


def test_simulated_stamps_are_not_of_poses_on_the_system_clock() -> None:
    poses = [NOW + 10 * MS * i for i in range(100)]
    assert BagClock(poses, poses).told(5_000 * MS, NOW + 300 * MS, kept=True) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("stamps", "run"),
    [
        ([0, 10, 20], (0, 3)),
        ([0, 20, 10, 30], (0, 4)),  # overtaken
        ([7_000, 7_010, 0, 10, 20], (2, 5)),
        ([0, 2_000, 4_000, 10, 20], (0, 3)),
    ],
)
def test_a_simulator_started_again_is_another_run(stamps, run) -> None:
    assert longest_run([stamp * MS for stamp in stamps]) == slice(*run)
