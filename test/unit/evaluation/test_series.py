# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Series of values over time, of samples and of what lasts until the next value."""

import numpy as np
import pytest

from sphere_sim.evaluation.series import Series

TIMES = np.array([-1.0, 1.0, 2.0])
SAMPLES = Series(TIMES, np.array([[10.0], [20.0], [40.0]]))
LASTING = Series.of(zip(TIMES, "abc", strict=True), lasting=True)


@pytest.mark.parametrize(("time", "value"), [
    (-1.5, "none"), (-1.0, "a"), (0.9, "a"), (1.0, "b"), (9.0, "c"),
])
def test_newest_value_counts_from_its_time_on(time, value) -> None:
    assert LASTING.at(time, "none") == value


def test_part_begins_with_what_is_in_force_and_ends_before_its_end() -> None:
    part = LASTING.between(0.5, 2.0)
    assert part.values == ("a", "b") and part.times.tolist() == [-1.5, 0.5] and part.lasting
    samples = SAMPLES.between(0.5, 2.0)
    assert samples.values.tolist() == [[20.0]] and samples.times.tolist() == [0.5]
    assert not SAMPLES.between(2.5, 9.0) and LASTING.between(2.5, 9.0).values == ("c",)


def test_times_that_differ_by_rounding_alone_are_the_same() -> None:
    assert SAMPLES.between(1.0 + 1e-10, 2.0 + 1e-10).times == pytest.approx([0.0], abs=1e-9)
    assert not SAMPLES.between(1.0 + 1e-9, 2.0)


def test_values_are_linear_between_the_times_and_outside_as_asked_for() -> None:
    times = np.array([-2.0, 0.0, 1.5, 3.0])
    assert SAMPLES.interpolated(times)[:, 0].tolist() == [10.0, 15.0, 30.0, 40.0]
    known = SAMPLES.interpolated(times, np.nan)[:, 0]
    np.testing.assert_array_equal(known, [np.nan, 15.0, 30.0, np.nan])
    empty = Series(values=np.empty((0, 2))).interpolated(times)
    assert empty.shape == (4, 2) and np.isnan(empty).all()


def test_each_time_is_of_one_value_and_of_equal_times_the_first_counts() -> None:
    found = [(value, here.tolist()) for value, here in LASTING.during(np.array([-3.0, 0.0, 2.0]))]
    assert found == [
        ("a", [False, True, False]), ("b", [False, False, False]), ("c", [False, False, True]),
    ]
    series = Series.of_numbers(np.array([2.0, 1.0, 2.0]), np.array([[1.0], [2.0], [3.0]]))
    assert series.times.tolist() == [1.0, 2.0] and series.values[:, 0].tolist() == [2.0, 1.0]
