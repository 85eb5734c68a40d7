# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Each disturbance changes the poses according to its name, and nothing else."""

import numpy as np
import pytest

from sphere_sim.faults.pose_stream import PoseSample, PoseStream, make_disturbance

PERIOD = 50_000_000
"""Spacing of the samples [ns]."""
COUNT = 200


def sample(number: int) -> PoseSample:
    return PoseSample(number * PERIOD, (float(number), 0.0, 0.6, 0.0, 0.8, 0.0), "world")


def passed(*given: dict, seed: int = 1) -> list[tuple[int, PoseSample]]:
    """Return the samples that leave the stream, each with the number of its period."""
    stream = PoseStream(np.random.default_rng(seed))
    stream.disturbances.extend(make_disturbance(options) for options in given)
    out = []
    for number in range(2 * COUNT):
        if number < COUNT:
            stream.enter(number * PERIOD, sample(number))
        out.extend((number, left) for left in stream.leave(number * PERIOD))
    return out


def test_stream_without_disturbances_is_unchanged() -> None:
    assert passed() == [(number, sample(number)) for number in range(COUNT)]


@pytest.mark.parametrize(
    ("share", "least", "most"), [(0.1, 160, 195), (0.5, 70, 130), (1.0, 0, 0)]
)
def test_share_of_the_samples_is_lost_and_the_rest_is_as_it_was(share, least, most) -> None:
    out = passed({"disturbance": "dropped", "share": share})
    assert least <= len(out) <= most
    assert all(left == sample(number) for number, left in out)


def test_delayed_samples_keep_their_stamps() -> None:
    out = passed({"disturbance": "delayed", "by": 0.2})
    assert out == [(number + 4, sample(number)) for number in range(COUNT)]


def test_shuffled_samples_overtake_each_other_and_none_is_lost() -> None:
    stamps = [left.stamp for _, left in passed({"disturbance": "shuffled", "within": 0.15})]
    assert stamps != sorted(stamps)
    assert sorted(stamps) == [number * PERIOD for number in range(COUNT)]


def test_duplicated_samples_arrive_at_the_same_time() -> None:
    out = passed({"disturbance": "duplicated", "times": 3})
    assert out == [(number, sample(number)) for number in range(COUNT) for _ in range(3)]


def test_stamps_are_moved_ahead() -> None:
    out = passed({"disturbance": "stamped", "ahead": 0.3})
    assert [left.stamp for _, left in out] == [n * PERIOD + 300_000_000 for n in range(COUNT)]


def test_one_number_of_a_share_is_not_finite() -> None:
    out = passed({"disturbance": "not_finite", "share": 0.3})
    corrupted = [np.count_nonzero(~np.isfinite(left.values)) for _, left in out]
    assert set(corrupted) == {0, 1}
    assert 30 <= sum(corrupted) <= 90


def test_flipped_quaternions_are_the_same_rotation() -> None:
    turns = np.array([left.values[2:] for _, left in passed({"disturbance": "sign_flipped"})])
    signs = turns @ np.array([0.6, 0.0, 0.8, 0.0])
    assert set(np.round(signs, 12)) == {-1.0, 1.0}


def test_norm_and_frame_are_changed() -> None:
    out = passed({"disturbance": "scaled", "by": 2.0}, {"disturbance": "framed", "frame": "map"})
    assert all(np.linalg.norm(left.values[2:]) == pytest.approx(2.0) for _, left in out)
    assert {left.frame for _, left in out} == {"map"}


def test_disturbances_act_one_after_the_other() -> None:
    twice = {"disturbance": "duplicated", "times": 2}
    assert len(passed(twice, {"disturbance": "delayed", "by": 1.0}, twice)) == 4 * COUNT


def test_random_disturbances_follow_from_the_seed() -> None:
    half = {"disturbance": "dropped", "share": 0.5}
    assert passed(half, seed=3) == passed(half, seed=3)
    assert passed(half, seed=3) != passed(half, seed=4)


def test_pending_samples_are_discarded_when_time_restarts() -> None:
    stream = PoseStream(np.random.default_rng(0))
    stream.disturbances.append(make_disturbance({"disturbance": "delayed", "by": 1.0}))
    stream.enter(0, sample(0))
    stream.clear()
    assert stream.leave(10**12) == []
