# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Equations of the paper as printed against the motion: which hold, which need correcting.

The motion is that of the NumPy plant, whose rates come from Eqs. (3), (7) and a momentum balance
that is put together from the bodies; the list of misprints is in ``msg_docs/conventions.md``.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
RADIUS = ROBOT.shell_radius

HOLDS = 1e-12
"""Rounding of terms of order 10 at most."""

FAILS = 1e-2
"""A misprint shows in the largest residual of many random states far above rounding."""


def motions(number: int = 50, seed: int = 0) -> list[tuple[Vector, Vector, Vector, Vector]]:
    """Return states, inputs, state rates and body rates of the plant."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(number):
        q = rng.normal(size=4)
        x = np.concatenate((rng.uniform(-3, 3, 2), q / np.linalg.norm(q)))
        found.append((x, *rates(x, rng.uniform(-100, 100, 2))))
    return found


def rates(x: Vector, u: Vector) -> tuple[Vector, Vector, Vector]:
    plant = RollingPlant(ROBOT, x)
    return u, np.array(plant._rate(tuple(x), *u)), np.array(plant._body_rate(tuple(x), *u))


def to_world(x: Vector) -> Vector:
    return Rotation.from_quat(x[[3, 4, 5, 2]]).as_matrix()


def largest(residuals: list[Vector]) -> float:
    return float(np.max(np.abs(residuals)))


def test_eq_4_needs_a_factor_of_two() -> None:
    printed, corrected = [], []
    for x, _, dx, body in motions():
        q1, q2, q3, q4 = x[2:6]
        matrix = np.array([[-q2, q1, -q4, q3], [-q3, q4, q1, -q2], [-q4, -q3, q2, q1]])
        spin = to_world(x) @ body
        printed.append(matrix @ dx[2:6] - spin)
        corrected.append(2.0 * matrix @ dx[2:6] - spin)
    assert largest(printed) > FAILS
    assert largest(corrected) < HOLDS


def test_eq_7_holds_as_printed() -> None:
    residuals = []
    for x, _, dx, body in motions():
        q1, q2, q3, q4 = x[2:6]
        d1, d2, d3, d4 = dx[2:6]
        rolled = 2.0 * RADIUS * np.array([
            -q3 * d1 + q4 * d2 + q1 * d3 - q2 * d4, q2 * d1 - q1 * d2 + q4 * d3 - q3 * d4,
        ])
        residuals.append(dx[:2] - rolled)
        # The same from the rotation itself: the contact point is at rest.
        spin = to_world(x) @ body
        residuals.append(dx[:2] - RADIUS * np.array([spin[1], -spin[0]]))
    assert largest(residuals) < HOLDS


def test_eq_10_needs_the_factor_of_two_of_eq_7() -> None:
    mass = ROBOT.total_mass
    printed, corrected = [], []
    for x, _, dx, _ in motions():
        q1, q2, q3, q4 = x[2:6]
        d1, d2, d3, d4 = dx[2:6]
        momentum = mass * RADIUS * np.array([
            -q3 * d1 + q4 * d2 + q1 * d3 - q2 * d4, q2 * d1 - q1 * d2 + q4 * d3 - q3 * d4,
        ])
        printed.append(momentum - mass * dx[:2])
        corrected.append(2.0 * momentum - mass * dx[:2])
    assert largest(printed) > FAILS
    assert largest(corrected) < HOLDS * 10.0  # times the mass


def test_eq_12_needs_a_minus_in_its_third_line() -> None:
    it1, it2, i1 = ROBOT.transverse_inertia, ROBOT.axial_inertia, ROBOT.rotor_axial_inertia
    rolling = ROBOT.total_mass * RADIUS
    first, second, printed, corrected = [], [], [], []
    for x, u, dx, _ in motions():
        q1, q2, q3, q4 = x[2:6]
        d1, d2, d3, d4 = dx[2:6]
        vx, vy = dx[:2]
        first.append(
            2 * it1 * (-d1 * q2 + d2 * q1 + d3 * q4 - d4 * q3) + i1 * u[0]
            + 2 * rolling * vx * (q1 * q4 + q2 * q3)
            + rolling * vy * (q3**2 + q4**2 - q1**2 - q2**2)
        )
        second.append(
            2 * it1 * (-d1 * q3 - d2 * q4 + d3 * q1 + d4 * q2) + i1 * u[1]
            + 2 * rolling * vy * (q1 * q4 - q2 * q3)
            + rolling * vx * (q1**2 + q3**2 - q2**2 - q4**2)
        )
        moved = rolling * (vx * (q1 * q2 - q3 * q4) + vy * (q1 * q3 + q2 * q4))
        spun = it2 * (-d1 * q4 + d2 * q3 - d3 * q2 + d4 * q1)
        printed.append(moved + spun)
        corrected.append(-moved + spun)
    assert largest(first) < HOLDS
    assert largest(second) < HOLDS
    assert largest(printed) > FAILS
    assert largest(corrected) < HOLDS


def test_body_rate_below_eq_12_needs_a_factor_of_two() -> None:
    printed, corrected = [], []
    for x, _, dx, body in motions():
        q1, q2, q3, q4 = x[2:6]
        d1, d2, d3, d4 = dx[2:6]
        given = -d1 * q4 + d2 * q3 - d3 * q2 + d4 * q1
        printed.append(given - body[2])
        corrected.append(2.0 * given - body[2])
    assert largest(printed) > FAILS
    assert largest(corrected) < HOLDS


def test_eq_19_needs_the_sign_of_eq_18() -> None:
    rng = np.random.default_rng(1)
    printed, corrected = [], []
    for q3, q4 in rng.uniform(-0.7, 0.7, size=(50, 2)):
        q1, q2 = np.sqrt(0.5 - q4**2), np.sqrt(0.5 - q3**2)
        east = 2 * RADIUS * (q3 * q1 - q4 * q2)
        printed.append(np.hypot(east, -2 * RADIUS * (q2 * q1 - q3 * q4)) - RADIUS)
        corrected.append(np.hypot(east, -2 * RADIUS * (q2 * q1 + q3 * q4)) - RADIUS)
    assert largest(printed) > FAILS
    assert largest(corrected) < HOLDS


def box_1(alpha: float, phi: float, sign: float) -> Vector:
    """Return the quaternion of Box I, with `sign` in front of its second component."""
    return np.sqrt(0.5) * np.array([
        np.cos(alpha / 2), sign * np.sin(alpha / 2 + phi), np.cos(alpha / 2 + phi),
        np.sin(alpha / 2),
    ])


ANGLES = [(a, f) for a in (0.3, 1.7, 4.4) for f in (-2.5, -0.6, 0.9, 2.2)]


@pytest.mark.parametrize(("alpha", "phi"), ANGLES)
def test_box_1_needs_a_minus_to_equal_its_product(alpha: float, phi: float) -> None:
    about = Rotation.from_rotvec(np.pi / 2 * np.array([-np.sin(phi), np.cos(phi), 0.0]))
    product = (Rotation.from_rotvec([0, 0, alpha]) * about).as_quat()[[3, 0, 1, 2]]

    def apart(q: Vector) -> float:
        return min(np.linalg.norm(q - product), np.linalg.norm(q + product))

    assert apart(box_1(alpha, phi, -1.0)) < HOLDS
    assert apart(box_1(alpha, phi, 1.0)) > FAILS
    # Both lie on Gamma; the corrected one with the named point of the shell on the ground.
    down = Rotation.from_quat(box_1(alpha, phi, -1.0)[[1, 2, 3, 0]]).apply(
        [np.cos(phi), np.sin(phi), 0.0]
    )
    np.testing.assert_allclose(down, [0, 0, -1], atol=HOLDS)


@pytest.mark.parametrize(("alpha", "phi"), ANGLES)
def test_on_gamma_every_input_rolls_along_the_line_of_corollary_1(
    alpha: float, phi: float
) -> None:
    line = np.array([np.cos(alpha + phi), np.sin(alpha + phi)])
    across = np.array([-line[1], line[0]])
    corrected = np.concatenate((np.zeros(2), box_1(alpha, phi, -1.0)))
    misprinted = np.concatenate((np.zeros(2), box_1(alpha, phi, 1.0)))
    rng = np.random.default_rng(2)
    astray, along = [], []
    for u in rng.uniform(-100, 100, size=(20, 2)):
        _, dx, _ = rates(corrected, u)
        assert abs(dx[:2] @ across) < HOLDS
        along.append(abs(dx[:2] @ line))
        # The paper's own expressions for the velocity, up to a common factor.
        vx = u[1] * np.cos(alpha) + u[0] * np.sin(alpha)
        vx += u[1] * np.cos(alpha + 2 * phi) - u[0] * np.sin(alpha + 2 * phi)
        vy = u[1] * np.sin(alpha) - u[0] * np.cos(alpha)
        vy += u[0] * np.cos(alpha + 2 * phi) + u[1] * np.sin(alpha + 2 * phi)
        assert abs(vx * dx[1] - vy * dx[0]) < HOLDS * 1e3  # products of 200 rad/s and 5 m/s
        astray.append(abs(rates(misprinted, u)[1][:2] @ across))
    assert max(along) > FAILS
    assert max(astray) > FAILS


@pytest.mark.parametrize(("alpha", "phi"), ANGLES)
def test_on_gamma_one_input_spins_in_place_as_remark_1_says(alpha: float, phi: float) -> None:
    x = np.concatenate((np.zeros(2), box_1(alpha, phi, -1.0)))
    columns = np.column_stack([rates(x, u)[1][:2] for u in np.eye(2)])
    assert abs(np.linalg.det(columns)) < HOLDS
    spin_input = np.linalg.svd(columns)[2][1]
    _, dx, body = rates(x, 100.0 * spin_input)
    np.testing.assert_allclose(dx[:2], 0.0, atol=HOLDS)
    spin = to_world(x) @ body
    np.testing.assert_allclose(spin[:2], 0.0, atol=HOLDS * 10.0)
    assert abs(spin[2]) > 0.1


def test_off_gamma_the_centre_can_move_in_every_direction() -> None:
    for x, *_ in motions(20, seed=3):
        columns = np.column_stack([rates(x, u)[1][:2] for u in np.eye(2)])
        # The slowest direction vanishes only with the height of the contact point.
        fastest, slowest = np.linalg.svd(columns)[1]
        height = abs(to_world(x)[2, 2])
        assert slowest >= height * fastest > HOLDS
    upright = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    columns = np.column_stack([rates(upright, u)[1][:2] for u in np.eye(2)])
    values = np.linalg.svd(columns)[1]
    assert values[0] == pytest.approx(values[1])


@pytest.mark.parametrize("seed", range(3))
def test_path_of_the_contact_point_crosses_gamma_at_a_right_angle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    alpha, phi = rng.uniform(0, 6, 2)
    x = np.concatenate((np.zeros(2), box_1(alpha, phi, -1.0)))
    for u in rng.uniform(-100, 100, size=(10, 2)):
        _, _, body = rates(x, u)
        # The contact point -Rs k moves over the shell as k does in the body: k' = -omega x k.
        k = to_world(x)[2]
        path = RADIUS * np.cross(body, k)
        np.testing.assert_allclose(path[:2], 0.0, atol=HOLDS)


def test_every_test_named_in_the_table_of_errata_exists() -> None:
    root = Path(__file__).parents[3]
    named = set(re.findall(r"`(test_\w+)`", (root / "msg_docs/conventions.md").read_text()))
    source = "".join(path.read_text() for path in (root / "test/sphere_nmpc").rglob("test_*.py"))
    assert named
    assert not {name for name in named if f"def {name}(" not in source}
