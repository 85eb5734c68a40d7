# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Fastest motions along paths, compiled and plain."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from compiled_solver import compiled
from given_paths import CIRCLE, CORNER, EIGHT, LINE, TOLERANCE, path_of

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import POSITION, Vector, make_state, without_momentum
from sphere_nmpc.solver.path_motion import (
    PathLimits,
    PathMotion,
    PathProblem,
    _plain,
    along_path,
)
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.evaluation.metrics import deviations

CONSTANTS = RobotParameters().lumped.as_array()
FAST, PACED, WEAK = (PathLimits(*x) for x in ((100.0, 400.0, 0.0), (100.0, 400.0, 0.3),
                                              (60.0, 150.0, 0.5)))
STEADY = 0.742
"""Speed of steady rolling [m/s]."""
SHAPES = {"line": LINE, "circle": CIRCLE, "eight": EIGHT, "corner": CORNER}


def problem(shape: str, seed: int, limits: PathLimits = FAST, off: float = 0.0,
            speeds: Vector = (0.0, 0.0), **others: Any) -> PathProblem:
    """Return that of a motion from the start of a path, or `off` [m] beside it, at random."""
    rng, path = np.random.default_rng(seed), path_of(SHAPES[shape])
    start = make_state(path.places[0] + off, random_quaternion(rng))
    given = {"way": 0.0, "last": path.length, "turn": rng.uniform(-1.0, 1.0), **others}
    return PathProblem(
        path, state=without_momentum(start), speeds=np.array(speeds), constants=CONSTANTS,
        limits=limits, **given,
    )


def trace(given: PathProblem, motion: PathMotion) -> tuple[Vector, Vector]:
    """Return times and places every 10 ms, by the roll-out of the knots."""
    times = np.unique(np.concatenate((motion.times, np.arange(0.0, motion.times[-1], 0.01))))
    speeds = [np.interp(times, motion.times, motion.speeds[:, i]) for i in (0, 1)]
    states = roll_out(given.state, np.column_stack(speeds), np.diff(times), CONSTANTS)
    return times, states[:, POSITION]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    ("limits", "others"),
    [
        (FAST, {}), (PACED, {"off": 0.01}), (WEAK, {"speeds": (20.0, -10.0), "last": 0.9}),
        (FAST, {"speeds": (60.0, 30.0)}), (FAST, {"speeds": (80.0, -60.0), "last": 0.01}),
    ],
    ids=["fast", "paced from beside", "weak and moving up to a stop", "moving", "stop at once"],
)
def test_compiled_motion_is_the_plain_one_within_its_limits(shape, limits, others) -> None:
    assert compiled()
    given = problem(shape, 1, limits, **others)
    found, plain = along_path(given), _plain(given)
    for one, other in zip(found, plain, strict=True):
        # Rounding, which some hundred steps with corrections multiply.
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-7)
    assert np.max(np.abs(found.speeds)) <= limits.speed + 1e-9
    slopes = np.diff(found.speeds, axis=0) / np.diff(found.times)[:, None]
    assert np.max(np.abs(slopes)) <= limits.acceleration * (1.0 + 1e-8)
    assert np.max(np.abs(found.speeds[-1])) < 1e-12
    assert np.all(np.diff(found.ways) >= 0.0) and found.times[0] == 0.0


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("limits", [FAST, PACED], ids=["fast", "paced"])
def test_motion_follows_the_path_at_its_pace_through_gamma(shape, limits) -> None:
    found = []
    for seed in range(12):
        given = problem(shape, seed, limits)
        motion = along_path(given)
        times, places = trace(given, motion)
        away, ways = deviations([given.path], places, 0.1)
        speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)
        assert np.max(speeds) < 1.01 * (limits.pace or STEADY)
        assert ways[-1] == pytest.approx(given.path.length, abs=TOLERANCE)
        least = given.path.length / (limits.pace or STEADY)
        found.append((
            np.max(away[times < 1.0]), np.max(away), motion.times[-1] / least
        ))
    # Linear speeds between knots differ from those of the law, and without corrections what they
    # lead to grows; a quarter of a second of a plan is followed. From near Gamma it is most.
    (soon, whole, slower), largest = np.median(found, axis=0), np.max(found, axis=0)
    assert soon < 1.5e-3 and largest[0] < 0.01 and whole < TOLERANCE
    assert 1.0 < slower < (1.06 if limits.pace else 1.6)


def test_fast_motion_takes_less_than_half_more_than_steady_rolling_on_a_circle() -> None:
    given = [problem("circle", seed) for seed in range(20)]
    took = [along_path(one).times[-1] / (one.path.length / STEADY) for one in given]
    assert np.median(took) < 1.45  # 1.37; the box of two rotors alone costs 1.27


@pytest.mark.parametrize("off", [0.01, 0.03, 0.1])
def test_motion_from_beside_the_path_joins_it(off) -> None:
    for seed in range(6):
        given = problem("line", seed, PACED, off=off)
        times, places = trace(given, along_path(given))
        away, _ = deviations([given.path], places, 0.1)
        assert away[0] > 0.99 * off
        # 10 cm take 0.5 s with the start, and what is left falls by e^-4 a radius, in a second.
        assert np.max(away[(times > 1.2) & (times < 1.5)]) < 6e-3


def test_path_of_the_centre_does_not_depend_on_the_pace() -> None:
    for seed in range(4):
        given = problem("circle", seed)
        times, places = trace(given, along_path(given))
        half = replace(given, limits=PathLimits(50.0, 100.0, 0.0))
        slow_times, slow = trace(half, along_path(half))
        same = [np.interp(2.0 * times, slow_times, slow[:, axis]) for axis in (0, 1)]
        np.testing.assert_allclose(np.column_stack(same), places, atol=1e-4)  # of chords, 10 ms
        # Other knots, as it accelerates relatively faster; samples are up to 7.5 mm apart.
        other = replace(given, limits=PathLimits(50.0, 200.0, 0.0))
        apart = np.linalg.norm(trace(other, along_path(other))[1][:, None] - places, axis=2)
        assert np.max(np.min(apart, axis=1)) < 6e-3
