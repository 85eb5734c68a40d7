# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Sampling instants from late ticks of a timer."""

import pytest

from sphere_nmpc.control.sample_grid import SampleGrid


def instants(grid: SampleGrid, *moments: float) -> list[float]:
    return [grid.instant(moment) for moment in moments]


def test_late_ticks_belong_to_their_instants() -> None:
    grid = SampleGrid(0.5)
    assert instants(grid, 1.0, 1.51, 2.2, 2.5) == pytest.approx([1.0, 1.5, 2.0, 2.5])
    assert grid.missed == 0


def test_first_tick_may_be_late_itself() -> None:
    grid = SampleGrid(0.5)
    assert instants(grid, 1.02, 1.5, 2.01) == pytest.approx([1.02, 1.5, 2.0])


def test_missed_instants_are_counted() -> None:
    grid = SampleGrid(0.5)
    instants(grid, 0.0, 0.5, 2.0)
    assert grid.missed == 2


def test_reset_takes_the_next_tick_as_it_comes() -> None:
    grid = SampleGrid(0.5)
    instants(grid, 0.0, 7.0)
    grid.reset()
    assert instants(grid, 3.3, 3.8) == pytest.approx([3.3, 3.8])
    assert grid.missed == 13
