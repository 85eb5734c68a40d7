# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Missed samples are reported where they go on, not at a slow start or one by one."""

import pytest

from sphere_nmpc.control.missed_samples import MissedSamples

SECONDS = 20


def reported(missed_in: list[int], rate: int = 500) -> list[float]:
    """Return the share after each second, of which so many instants were missed."""
    monitor, used, missed = MissedSamples(), 0, 0
    monitor.read(0.0, used, missed)
    shares = []
    for second, count in enumerate(missed_in, start=1):
        # Some seconds of a process that was held up hold more instants than `rate`.
        used, missed = used + max(0, rate - count), missed + count
        for part in (0.0, 0.25, 0.5, 0.75):
            monitor.read(second + part, used, missed)
        shares.append(monitor.share)
    return shares


@pytest.mark.parametrize(
    ("missed_in", "rate"),
    [
        ([0] * SECONDS, 500),
        ([900, 700, 300, 200, *[0] * (SECONDS - 4)], 500),
        ([0] * 10 + [1] + [0] * 9, 4),
        ([0] * 10 + [1_800_000] + [0] * 9, 500),
        ([10] * SECONDS, 500),
        ([1, 0] * 10, 4),
    ],
    ids=["none", "slow start", "single one", "clock set ahead", "two per cent", "now and then"],
)
def test_few_misses_or_a_single_gap_are_not_reported(missed_in, rate) -> None:
    assert not any(reported(missed_in, rate))


@pytest.mark.parametrize(("missed", "rate"), [(133, 500), (1, 4), (1, 2)])
def test_share_is_reported_after_five_seconds_and_until_it_is_over(missed, rate) -> None:
    shares = reported([missed] * 10 + [0] * 10, rate)
    assert shares[:4] == [0.0] * 4
    assert shares[4:10] == pytest.approx([missed / rate] * 6)
    assert shares[10] > 0.0 and shares[-6:] == [0.0] * 6


def test_share_that_varies_is_one_report() -> None:
    shares = reported([100] * 6 + [0, 30, 20, 100, 0, 40, 50, 0, 60, 20])
    assert all(shares[4:])
