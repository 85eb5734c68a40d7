# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Law along paths, against the model of the dynamics."""

import math

import casadi as ca
import numpy as np
import pytest
from given_paths import RADIUS, TOLERANCE

from sphere_nmpc.model.dynamics import state_rate
from sphere_nmpc.model.integrator import step_function
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import exponential, matrix, product, random_quaternion
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, make_state
from sphere_nmpc.solver.path_law import path_law_function

CONSTANTS = RobotParameters().lumped.as_array()
LAW, STEP = path_law_function(), step_function()
_X, _U = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
RATE = ca.Function("rate", [_X, _U], [state_rate(_X, _U, ca.DM(CONSTANTS))])
LATITUDES = (-1.3, -0.8, 0.9, 1.2)
"""Of the contact point [rad], where the spin is weighed by less than exp(-16)."""


def law(pose: Vector, point: Vector, turn: float = 0.0, left: float = 1.0) -> Vector:
    given = np.array([turn, left, TOLERANCE])
    return np.asarray(LAW(pose[QUATERNION], pose[POSITION], point, given, CONSTANTS)).ravel()


def velocity(pose: Vector, u: Vector) -> Vector:
    """Return that of the centre by the model [Rs a unit of time]."""
    return np.asarray(RATE(pose, u)).ravel()[POSITION] / RADIUS


def at_latitude(latitude: float, rng: np.random.Generator, place: Vector = (0.0, 0.0)) -> Vector:
    """Return a pose that is random but for the latitude of the contact point [rad]."""
    quaternion = random_quaternion(rng)
    axis = matrix(quaternion)[:, 2]
    level = np.array([axis[1], -axis[0], 0.0]) / math.hypot(axis[0], axis[1])
    rotation = exponential((latitude - math.asin(axis[2])) * level)
    return make_state(place, product(rotation, quaternion))


@pytest.mark.parametrize("latitude", LATITUDES)
@pytest.mark.parametrize("away", [0.0, 0.01, 0.1, 1.0])
def test_velocity_off_gamma_is_that_wanted_with_the_correction(latitude, away) -> None:
    rng = np.random.default_rng(3)
    for bend, turn in rng.uniform(-2.0, 2.0, (10, 2)):
        direction, beside = rng.uniform(-np.pi, np.pi, 2)
        error = away * np.array([math.cos(beside), math.sin(beside)])
        pose = at_latitude(latitude, rng, -RADIUS * error)
        found = law(pose, np.array([0.0, 0.0, direction, bend]), turn)
        pace = 1.0 / (1.0 + (away * RADIUS / TOLERANCE) ** 2)
        wanted = pace * np.array([math.cos(direction), math.sin(direction)])
        wanted += min(4.0, 1.0 / max(away, 1e-9)) * error
        share = found[2] / pace  # it is slower along the axis of a rotor
        assert 0.7 < share < 1.0 + 1e-9
        wanted *= share / max(1.0, np.linalg.norm(wanted))
        # 1e-9 Rs are added to distances where they are divided by.
        np.testing.assert_allclose(velocity(pose, found[:2]), wanted, atol=1e-6)
        assert np.max(np.abs(found[:2])) < 1.0 / CONSTANTS[1] + 1e-9
        assert found[4] == pytest.approx(math.tan(latitude))


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
    power = 1.0 / (1.0 - CONSTANTS[3])

    def exact(pose: Vector) -> Vector:
        columns = np.column_stack([velocity(pose, unit) for unit in np.eye(2)])
        return np.linalg.solve(columns, [1.0, 0.0])

    def constant(pose: Vector) -> float:
        axis = matrix(pose[QUATERNION])[:, 2]
        return float(axis[1] / abs(axis[2]) ** power)

    found = []
    for step in (0.01, 0.005):
        pose = at_latitude(latitude, np.random.default_rng(5))
        before = constant(pose)
        for _ in range(round(1.0 / step)):
            here = exact(pose)
            ahead = np.asarray(STEP(pose, here, here, step, CONSTANTS)).ravel()
            pose = np.asarray(STEP(pose, here, exact(ahead), step, CONSTANTS)).ravel()
            if abs(matrix(pose[QUATERNION])[2, 2]) < 0.2:
                break
        found.append(constant(pose) / before - 1.0)
    coarse, fine = found
    # Steps of second order: half of the step leaves a quarter of the error.
    assert abs(coarse) < 0.02 and abs(4.0 * fine - coarse) / 3.0 < 1e-3
