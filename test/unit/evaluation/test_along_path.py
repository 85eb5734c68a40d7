# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Metrics of a run along a path, of tracks whose deviations are known."""

import math

import numpy as np
import pytest

from sphere_nmpc.model.path import Path
from sphere_nmpc.model.state import Vector
from sphere_sim.evaluation.along_path import PathMetrics, measure_along

TOLERANCE, RADIUS, STEP = 0.02, 0.3, 0.01
ANGLES = np.linspace(0.0, 2.0 * np.pi, 1001)
EIGHT = np.column_stack((np.sin(ANGLES), np.sin(ANGLES) * np.cos(ANGLES)))


def measured(track: Vector, *curves: Vector) -> PathMetrics:
    times = STEP * np.arange(len(track))
    return measure_along(times, track, curves, TOLERANCE, RADIUS)


@pytest.mark.parametrize("off", [0.0, 0.004, -0.015])
def test_track_beside_a_closed_curve_deviates_as_far_and_arrives(off) -> None:
    normals = np.column_stack((np.cos(ANGLES), np.sin(ANGLES)))
    share = np.minimum(1.0, 20.0 * np.minimum(ANGLES, ANGLES[::-1]) / ANGLES[-1])
    track = normals + off * share[:, None] * normals
    rest = np.tile(track[-1], (200, 1))
    found = measured(np.vstack((track, rest)), normals)
    assert found.path_max_m == pytest.approx(abs(off), abs=2e-5)
    rms = math.sqrt(np.mean((off * share) ** 2))
    assert found.path_rms_m == pytest.approx(rms, rel=0.02, abs=2e-5)
    # From there on it is within 10 mm of the end.
    assert found.path_time_s == pytest.approx(STEP * 999, abs=2 * STEP)


def test_what_is_not_followed_counts_although_the_track_touches_the_curve() -> None:
    whole = measured(EIGHT, EIGHT)
    assert whole.path_max_m < 1e-6 and whole.path_time_s > 9.9
    assert math.isnan(measured(EIGHT[:1], EIGHT).path_time_s), "at its end, as at its start"
    half = measured(EIGHT[:500], EIGHT)
    assert math.isnan(half.path_time_s) and half.path_max_m < 1e-6
    short_cut = measured(np.vstack((EIGHT[:100], EIGHT[420:])), EIGHT)
    assert short_cut.path_max_m > 0.2
    other_way = measured(EIGHT[::-1], EIGHT)
    assert other_way.path_max_m > 0.5 and math.isnan(other_way.path_time_s)


def test_run_is_judged_from_the_start_of_the_path_on() -> None:
    line = np.column_stack((np.linspace(0.0, 1.0, 201), np.zeros(201)))
    to_the_start = np.column_stack((np.linspace(-0.5, 0.0, 100), np.linspace(0.3, 0.0, 100)))
    found = measured(np.vstack((to_the_start, line)), line)
    assert found.path_max_m <= TOLERANCE
    assert found.path_time_s == pytest.approx(STEP * 201, abs=6 * STEP)
    assert all(map(math.isnan, vars(measured(line + 0.1, line)).values()))


def test_paths_that_go_back_are_followed_one_after_the_other() -> None:
    there = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 0.0), (0.0, 0.5)])
    parts = [path.places for path in Path.through(there, TOLERANCE, RADIUS)]
    assert len(parts) == 2
    found = measured(np.vstack(parts), *parts)
    assert found.path_max_m < 1e-9 and found.path_time_s > 0.0
    stopped = measured(parts[0], *parts)
    assert stopped.path_max_m < 1e-9 and math.isnan(stopped.path_time_s)
