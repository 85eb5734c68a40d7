# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settling, errors and peaks of runs that are known by construction."""

import math

import numpy as np
import pytest

from sphere_nmpc.model import rotation
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.path import Path
from sphere_nmpc.model.state import Vector, angle_error, position_error, state_error
from sphere_sim.evaluation.metrics import (
    angle_errors,
    estimate_errors,
    measure,
    measure_along,
    position_errors,
    settling_index,
    state_errors,
    stay_below,
    touches,
)
from sphere_sim.evaluation.series import RobotSeries, Series

GOAL = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("of_many", "of_one"),
    [(state_errors, state_error), (position_errors, position_error), (angle_errors, angle_error)],
)
def test_errors_over_time_are_those_of_each_state(of_many, of_one) -> None:
    states = np.random.default_rng(3).normal(size=(50, 6))
    states[:, 2:] /= np.linalg.norm(states[:, 2:], axis=1, keepdims=True)
    expected = [of_one(state, GOAL) for state in states]
    np.testing.assert_allclose(of_many(states, GOAL), expected, rtol=1e-12)


def test_heading_error_is_about_the_vertical_of_the_world_whatever_the_tilt() -> None:
    rng, times = np.random.default_rng(4), np.array([1.0, 3.0])
    for q in rng.normal(size=(20, 4)):
        q /= np.linalg.norm(q)
        states = np.array([[0.0, 0.0, *q], [0.2, 0.0, *q]])
        turn = rng.normal(size=3) * 0.5
        turned = rotation.product(rotation.exponential(turn), q)
        estimate = np.array([0.13, 0.04, *turned * rng.choice((-1.0, 1.0))])
        given = Series(np.array([2.0, 4.0]), np.array(2 * [estimate]))
        errors = estimate_errors(given, Series(times, states))
        np.testing.assert_allclose(errors[0], (0.05, turn[2]), rtol=1e-9)
        assert np.all(np.isnan(errors[1])), "there is no true pose of that time"


@pytest.mark.parametrize(
    ("errors", "index"),
    [
        ([1.0, 0.5, 0.001, 0.002], 2),
        ([0.001, 0.001], 0),
        ([1.0, 0.001, 0.5], None),
        ([0.001, 0.5, 0.001], 2),
        ([0.001, math.nan], None),
        ([0.01], None),
    ],
)
def test_settling_counts_only_if_it_lasts(errors, index) -> None:
    assert settling_index(np.array(errors)) == index
    stay = stay_below(np.arange(len(errors)), np.array(errors), 1e-2)
    assert (None if stay is None else stay.since) == index
    assert stay is None or stay.largest == max(errors[index:]) >= stay.p95


def test_measure_of_a_straight_run() -> None:
    times = np.linspace(0.0, 10.0, 101)
    states = np.tile(GOAL, (101, 1))
    states[:, 0] = np.maximum(0.0, 5.0 - times)
    states[:, 2] = -1.0  # the other quaternion of the same orientation
    poses, known = Series(times, states), np.array([True, True, False])
    speeds = Series(np.arange(3.0), np.array([[1.0, -90.0], [-1.0, 30.0], [np.nan, 3.0]]))
    goal, solves = Goal(GOAL), np.array([0.001, 0.0, 0.003, np.nan, 0.0, 0.0])
    first = speeds.where(known)
    torques = Series(first.times, np.array([[0.1, 0.3], [0.1, 0.6]]))
    metrics = measure(RobotSeries(poses, first, torques), goal, solves)
    assert metrics.heat == pytest.approx(0.01 + 0.21)  # the second torque rises in a second
    assert metrics.energy_j == pytest.approx(0.1 + 0.5 * (27.0 + 18.0))
    unknown = Series(speeds.times, np.full((3, 2), np.nan))
    metrics = measure(RobotSeries(poses, speeds, unknown), goal, solves)
    assert metrics.settled and metrics.settle_time_s == pytest.approx(5.0)
    assert metrics.final_error == 0.0
    assert metrics.max_rotor_speed == 90.0
    assert math.isnan(metrics.max_rotor_torque_nm) and math.isnan(metrics.heat)
    assert metrics.solve_ms_p50 == pytest.approx(2.0)


def test_touches_are_counted_as_they_begin() -> None:
    clearances = np.array([0.0, -0.1, 0.1, np.nan, -0.1, -0.1, np.nan, 0.0, 0.2])
    assert touches(clearances).tolist() == [0, 4, 7]
    assert touches(np.array([0.1, np.nan])).size == 0


def along(track: Vector, *places: Vector) -> tuple[float, float, float]:
    """Return the metrics of a track, a place every 10 ms, along the paths through places."""
    paths = [path for part in places for path in Path.through(part, 0.02, 0.3)]
    return measure_along(0.01 * np.arange(len(track)), track, paths, 0.15)


@pytest.mark.parametrize("off", [0.0, 0.004, -0.015])
def test_run_beside_a_closed_path_deviates_as_far_and_comes_to_its_end(off) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 1001)
    circle = np.column_stack((np.cos(angles), np.sin(angles)))
    beside = off * np.minimum(1.0, 20.0 * np.minimum(angles, angles[::-1]) / angles[-1])
    track = np.vstack((circle * (1.0 + beside[:, None]), np.tile(circle[0], (200, 1))))
    rms, largest, duration = along(track, circle)
    assert largest == pytest.approx(abs(off), abs=1e-4), "as far as the curve is from the circle"
    assert rms == pytest.approx(np.sqrt(np.mean(beside**2)), rel=0.02, abs=1e-4)
    assert duration == pytest.approx(9.99, abs=0.03), "from there on it is within 10 mm"
    assert math.isnan(along(track[-200:], circle)[2]), "at its end, where it starts"


def test_part_of_a_path_that_is_left_out_counts_although_the_run_stays_on_the_path() -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 1001)
    eight = np.column_stack((np.sin(angles), np.sin(angles) * np.cos(angles)))
    assert along(eight, eight)[1] < 1e-3 and along(eight, eight)[2] > 9.9
    for track in (eight[::-1], np.vstack((eight[:100], eight[420:]))):
        assert along(track, eight)[1] > 0.2
    _, largest, duration = along(eight[:500], eight)
    assert largest < 1e-3 and math.isnan(duration)


def test_run_along_a_path_is_judged_once_it_is_on_it_and_where_it_turns_back() -> None:
    line = np.column_stack((np.linspace(0.0, 1.0, 201), np.zeros(201)))
    before = np.column_stack((np.linspace(-0.5, -0.03, 50), np.full(50, 0.3)))
    joining = np.vstack((line[60:80] + np.array((0.0, 0.1)), line[80:]))
    assert along(joining, line)[1:] == pytest.approx((0.0, 1.2), abs=0.04)
    back = np.vstack((line, line[::-1]))
    for track, end in ((line, 2.0), (back, 4.0)):
        _, largest, duration = along(np.vstack((before, track)), track)
        assert largest < 1e-9 and duration == pytest.approx(end, abs=0.04)
    assert along(line, back)[1] < 1e-9 and math.isnan(along(line, back)[2])
    assert all(map(math.isnan, along(line + 0.1, line)))
