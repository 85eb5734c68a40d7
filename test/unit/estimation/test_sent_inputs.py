# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""History of the rotor speeds sent."""

import numpy as np
import pytest

from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.model.first_order_hold import FirstOrderHold


def ramp(start: float, first: list[float], last: list[float], length: float) -> FirstOrderHold:
    return FirstOrderHold(np.array([start, start + length]), np.array([first, last], dtype=float))


def test_each_hold_lasts_until_the_next_takes_effect_and_an_earlier_one_replaces_later_ones():
    sent = SentInputs()
    sent.record(ramp(1.0, [0, 0], [10, 20], 1.0))
    sent.record(ramp(1.5, [5, 10], [0, 0], 0.5))
    np.testing.assert_allclose([sent.at(t)[0] for t in (0.5, 1.25, 1.75, 9.0)], [0, 2.5, 2.5, 0])
    sent.record(FirstOrderHold.constant(1.2, np.array([1.0, 1.0])))
    np.testing.assert_array_equal(sent.at(3.0), [1.0, 1.0])
    late = ramp(2.0, [1, 1], [3, 3], 0.5)
    sent.record(late)
    sent.withdraw(late)
    np.testing.assert_array_equal(sent.at(3.0), [1.0, 1.0])
    sent.record(ramp(4.0, [1, 1], [0, 0], 1.0))
    assert sent.moves_after(4.9) and not sent.moves_after(5.0)
    sent.clear()
    assert not sent.moves_after(0.0)


def test_pieces_are_the_speeds_in_force() -> None:
    rng, sent, now = np.random.default_rng(5), SentInputs(), 0.0
    for _ in range(40):
        now += float(rng.choice([0.002, 0.01, 0.25]))
        # Some holds have knots before the next one begins.
        times = now + np.concatenate(([0.0], np.cumsum(rng.uniform(1e-3, 0.02, 3))))
        speeds = np.vstack((sent.at(now), rng.uniform(-100.0, 100.0, (3, 2))))
        sent.record(FirstOrderHold(times, speeds))
    for start, end in ((-0.5, 0.0), (-0.5, now), (0.3 * now, 0.31 * now), (0.5 * now, now + 1.0)):
        durations, speeds = sent.pieces(start, end)
        ends = start + np.concatenate(([0.0], np.cumsum(durations)))
        assert ends[-1] == pytest.approx(end) and np.all(durations > 0.0)
        times = rng.uniform(start, end, 50)
        found = np.column_stack([np.interp(times, ends, column) for column in speeds.T])
        np.testing.assert_allclose(found, [sent.at(t) for t in times.tolist()], atol=1e-6)
