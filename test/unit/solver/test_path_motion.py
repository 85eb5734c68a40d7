# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Law along paths against the model, and fastest motions by it, compiled and plain."""

import math
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from compiled_solver import compiled
from given_paths import RADIUS, SHAPES, TOLERANCE, path_of

from sphere_nmpc.model.dynamics import state_rate
from sphere_nmpc.model.integrator import step_function
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import exponential, matrix, product, random_quaternion
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, make_state, without_momentum
from sphere_nmpc.solver.path_law import path_law_function
from sphere_nmpc.solver.path_motion import PathLimits, PathProblem, _plain, along_path
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.evaluation.metrics import deviations

CONSTANTS = RobotParameters().lumped.as_array()
LAW, STEP = path_law_function(), step_function()
_X, _U = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
RATE = ca.Function("rate", [_X, _U], [state_rate(_X, _U, ca.DM(CONSTANTS))])
LATITUDES = (-1.3, -0.8, 0.9, 1.2)
"""Of the contact point [rad], where the spin is weighed by less than exp(-16)."""
FAST = PathLimits(100.0, 400.0, math.inf)
PACED, WEAK = FAST._replace(pace=0.3), PathLimits(60.0, 150.0, 0.5)
STEADY = 0.742
"""Speed of steady rolling [m/s]."""


def law(pose: Vector, point: Vector, turn: float) -> Vector:
    given = np.array([turn, 1.0, TOLERANCE])
    return np.asarray(LAW(pose[QUATERNION], pose[POSITION], point, given, CONSTANTS)).ravel()


def velocity(pose: Vector, u: Vector) -> Vector:
    """Return that of the centre by the model [Rs a unit of time]."""
    return np.asarray(RATE(pose, u)).ravel()[POSITION] / RADIUS


def at_latitude(latitude: float, rng: np.random.Generator, place: Vector = (0.0, 0.0)) -> Vector:
    """Return a pose that is random but for the latitude of the contact point [rad]."""
    quaternion = random_quaternion(rng)
    axis = matrix(quaternion)[:, 2]
    level = np.array([axis[1], -axis[0], 0.0]) / np.hypot(axis[0], axis[1])
    return make_state(place, product(exponential((latitude - np.arcsin(axis[2])) * level),
                                     quaternion))


@pytest.mark.parametrize("latitude", LATITUDES)
@pytest.mark.parametrize("away", [1e-9, 0.01, 0.1, 1.0])
def test_velocity_off_gamma_is_that_wanted_with_the_correction(latitude, away) -> None:
    rng = np.random.default_rng(3)
    for direction, beside, bend, turn in rng.uniform(-2.0, 2.0, (10, 4)):
        error = away * np.array([np.cos(beside), np.sin(beside)])
        pose = at_latitude(latitude, rng, -RADIUS * error)
        found = law(pose, np.array([0.0, 0.0, direction, bend]), turn)
        pace = 1.0 / (1.0 + (away * RADIUS / TOLERANCE) ** 2)
        wanted = pace * np.array([np.cos(direction), np.sin(direction)])
        wanted += min(4.0, 1.0 / away) * error
        wanted *= found[2] / pace / max(1.0, np.linalg.norm(wanted))  # slower on a rotor's axis
        # 1e-9 Rs are added to distances where they are divided by.
        np.testing.assert_allclose(velocity(pose, found[:2]), wanted, atol=1e-6)
        assert 0.7 < found[2] / pace < 1.0 + 1e-9
        assert np.max(np.abs(found[:2])) < 1.0 / CONSTANTS[1] + 1e-9


def test_law_is_finite_on_gamma_and_continuous_across_it() -> None:
    rng, point = np.random.default_rng(4), np.array([0.0, 0.0, 0.0, 1.0])
    for _ in range(100):
        pose = at_latitude(0.0, rng, 0.01 * rng.standard_normal(2))
        here = law(pose, point, 0.5)
        assert np.all(np.isfinite(here))
        for turn in 1e-7 * rng.standard_normal((3, 3)):
            other = make_state(pose[POSITION], product(exponential(turn), pose[QUATERNION]))
            # It changes by 330 a radian, where the sphere rolls across its axis; a jump is of 1.
            np.testing.assert_allclose(law(other, point, 0.5), here, atol=1e-3)


@pytest.mark.parametrize("latitude", LATITUDES)
def test_heading_along_a_line_is_conserved_over_a_power_of_the_latitude(latitude) -> None:
    """w_n cos(phi) / |sin(phi)|^p: with exact rolling, p = 1 / (1 - r3)."""

    def exact(pose: Vector) -> Vector:
        columns = np.column_stack([velocity(pose, unit) for unit in np.eye(2)])
        return np.linalg.solve(columns, [1.0, 0.0])

    def constant(pose: Vector) -> float:
        axis = matrix(pose[QUATERNION])[:, 2]
        return float(axis[1] / abs(axis[2]) ** (1.0 / (1.0 - CONSTANTS[3])))

    found = []
    for step in (0.01, 0.005):
        pose = at_latitude(latitude, np.random.default_rng(5))
        before, left = constant(pose), round(1.0 / step)
        while left and abs(matrix(pose[QUATERNION])[2, 2]) > 0.2:
            here, left = exact(pose), left - 1
            ahead = np.asarray(STEP(pose, here, here, step, CONSTANTS)).ravel()
            pose = np.asarray(STEP(pose, here, exact(ahead), step, CONSTANTS)).ravel()
        found.append(constant(pose) / before - 1.0)
    coarse, fine = found
    # Steps of second order: half of the step leaves a quarter of the error.
    assert abs(coarse) < 0.02 and abs(4.0 * fine - coarse) / 3.0 < 1e-3


def problem(shape: str, seed: int, limits: PathLimits = FAST, off: float = 0.0,
            speeds: Vector = (0.0, 0.0), **others: Any) -> PathProblem:
    """Return that of a motion from the start of a path, or `off` [m] beside it, at random."""
    rng, path = np.random.default_rng(seed), path_of(SHAPES[shape])
    state = without_momentum(make_state(path.places[0] + off, random_quaternion(rng)))
    given = {"way": 0.0, "last": path.length, "turn": rng.uniform(-1.0, 1.0), **others}
    return PathProblem(path, state=state, speeds=np.array(speeds), constants=CONSTANTS,
                       limits=limits, **given)


def trace(given: PathProblem) -> tuple[Vector, Vector]:
    """Return times and places every 10 ms, by the roll-out of the knots."""
    motion = along_path(given)
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
    found = along_path(given)
    for one, other in zip(found, _plain(given), strict=True):
        # Rounding, which some hundred steps with corrections multiply.
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-7)
    slopes = np.diff(found.speeds, axis=0) / np.diff(found.times)[:, None]
    assert np.max(np.abs(found.speeds)) <= limits.speed + 1e-9
    assert np.max(np.abs(slopes)) <= limits.acceleration * (1.0 + 1e-8)
    assert not np.any(found.speeds[-1]) and np.all(np.diff(found.ways) >= 0.0)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("limits", [FAST, PACED], ids=["fast", "paced"])
def test_motion_follows_the_path_at_its_pace_through_gamma(shape, limits) -> None:
    found, steady = [], min(limits.pace, STEADY)
    for seed in range(12):
        given = problem(shape, seed, limits)
        times, places = trace(given)
        away, _ = deviations([given.path], places, 0.1)
        speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)
        assert np.max(speeds) < 1.01 * steady
        slower = times[-1] / (given.path.length / steady)
        found.append((np.max(away[times < 1.0]), np.max(away), slower))
    # Linear speeds between knots differ from those of the law, and without corrections what they
    # lead to grows; a quarter of a second of a plan is followed. From near Gamma it is most.
    (soon, whole, slower), largest = np.median(found, axis=0), np.max(found, axis=0)
    assert soon < 1.5e-3 and largest[0] < 0.01 and whole < TOLERANCE
    # The box of two rotors alone costs 1.27; a corner of a short path is passed slower.
    most = (1.06 if limits is PACED else 1.45) + (0.1 if shape == "corner" else 0.0)
    assert 1.0 < slower < most


@pytest.mark.parametrize("off", [0.01, 0.03, 0.1])
def test_motion_from_beside_the_path_joins_it(off) -> None:
    for seed in range(6):
        given = problem("line", seed, PACED, off=off)
        times, places = trace(given)
        away, _ = deviations([given.path], places, 0.1)
        # 10 cm take 0.5 s with the start, and what is left falls by e^-4 a radius, in a second.
        assert away[0] > 0.99 * off and np.max(away[(times > 1.2) & (times < 1.5)]) < 6e-3


def test_path_of_the_centre_does_not_depend_on_the_pace() -> None:
    for seed in range(4):
        given = problem("circle", seed)
        times, places = trace(given)
        slow_times, slow = trace(replace(given, limits=PathLimits(50.0, 100.0, math.inf)))
        same = [np.interp(2.0 * times, slow_times, slow[:, axis]) for axis in (0, 1)]
        np.testing.assert_allclose(np.column_stack(same), places, atol=1e-4)  # of chords, 10 ms
        # Other knots, as it accelerates relatively faster; samples are up to 7.5 mm apart.
        _, other = trace(replace(given, limits=PathLimits(50.0, 200.0, math.inf)))
        apart = np.linalg.norm(other[:, None] - places, axis=2)
        assert np.max(np.min(apart, axis=1)) < 6e-3
