# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Lengths as text, in the unit in which they are read easily."""

import math

import pytest

from sphere_sim.output.round_numbers import length


@pytest.mark.parametrize(
    ("value", "text"),
    [(5e-6, "0.005 mm"), (0.0, "0 mm"), (-0.1, "-100 mm"), (0.9994, "999 mm"), (0.9996, "1 m"),
     (141.4, "141 m"), (math.nan, "nan mm")],
)
def test_length_is_in_metres_from_one_metre_on(value, text) -> None:
    assert length(value) == text
