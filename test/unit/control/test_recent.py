# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Newest values of a stream."""

import math

import numpy as np
import pytest

from sphere_nmpc.control.recent import Recent


def test_mean_and_quantiles_are_those_of_the_newest_values() -> None:
    recent, values = Recent(5), np.random.default_rng(1).normal(size=9)
    assert math.isnan(recent.mean) and math.isnan(recent.quantile(0.5)) and not recent.is_full
    recent.extend(values)
    assert recent.is_full and recent.mean == pytest.approx(np.mean(values[4:]), abs=1e-15)
    for share in (0.0, 0.3, 0.5, 1.0):
        expected = np.quantile(values[4:], share)
        assert recent.quantile(share) == pytest.approx(expected, abs=1e-15)


def test_quantiles_leave_out_what_is_unknown() -> None:
    recent = Recent(3)
    recent.extend((math.nan, 2.0, 1.0))
    assert (recent.quantile(0.0), recent.quantile(1.0)) == (1.0, 2.0)
