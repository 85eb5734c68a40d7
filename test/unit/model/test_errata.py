# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Equations of the paper as printed against the motion: which hold, which need correcting.

The motion is that of the NumPy plant, whose rates come from Eqs. (3), (7) and a momentum balance
that is put together from the bodies; the list of misprints is in ``msg_docs/conventions.md``.
"""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import Vector, make_state, upright_state
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
RADIUS = ROBOT.shell_radius

HOLDS = 1e-12
"""Rounding of terms of order 10 at most."""

PERIOD, HORIZON, ALPHA, BETA = 0.5, 4, 0.5, 1e8
"""Sample period [s], horizon and weights of the paper's section 4."""

NEIGHBOURHOOD = 1e-2
"""Radius of D with these weights."""

FAILS = 1e-2
"""A misprint shows in the largest residual of many random states far above rounding."""


def rates(x: Vector, u: Vector) -> tuple[Vector, Vector]:
    """Return the rate of the state and the body rate of the plant."""
    plant = RollingPlant(ROBOT, x)
    plant._speeds = (float(u[0]), float(u[1]))
    return np.array(plant.rate((*x, 0.0, 0.0, 0.0), *u)[:6]), plant.body_rate


def to_world(x: Vector) -> Vector:
    return Rotation.from_quat(x[..., [3, 4, 5, 2]]).as_matrix()


class Motions:
    """Random motions of the plant: each number of the paper is an array."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        x = np.array([make_state((0.0, 0.0), random_quaternion(rng)) for _ in range(50)])
        u = rng.uniform(-100, 100, (50, 2))
        dx, self.body = map(np.array, zip(*map(rates, x, u), strict=True))
        self.u, self.v, self.q, self.dq = u.T, dx[:, :2].T, x[:, 2:6].T, dx[:, 2:6].T
        self.spin = np.einsum("kij,kj->ik", to_world(x), self.body)


Residuals = tuple[Vector, Vector]


def eq_4(m: Motions) -> Residuals:
    """A factor of two is missing."""
    q1, q2, q3, q4 = m.q
    matrix = np.array([[-q2, q1, -q4, q3], [-q3, q4, q1, -q2], [-q4, -q3, q2, q1]])
    found = np.einsum("ijk,jk->ik", matrix, m.dq)
    return found - m.spin, 2.0 * found - m.spin


def eq_10(m: Motions) -> Residuals:
    """The factor of two of Eq. (7) is missing."""
    (q1, q2, q3, q4), (d1, d2, d3, d4) = m.q, m.dq
    velocity = RADIUS * np.array([
        -q3 * d1 + q4 * d2 + q1 * d3 - q2 * d4, q2 * d1 - q1 * d2 + q4 * d3 - q3 * d4,
    ])
    return velocity - m.v, 2.0 * velocity - m.v


def eq_12(m: Motions) -> Residuals:
    """The third line needs a minus; the first two hold."""
    (q1, q2, q3, q4), (d1, d2, d3, d4), (vx, vy) = m.q, m.dq, m.v
    it1, it2, i1 = ROBOT.transverse_inertia, ROBOT.axial_inertia, ROBOT.rotor_axial_inertia
    rolling = ROBOT.total_mass * RADIUS
    first = (
        2 * it1 * (-d1 * q2 + d2 * q1 + d3 * q4 - d4 * q3) + i1 * m.u[0]
        + 2 * rolling * vx * (q1 * q4 + q2 * q3)
        + rolling * vy * (q3**2 + q4**2 - q1**2 - q2**2)
    )
    second = (
        2 * it1 * (-d1 * q3 - d2 * q4 + d3 * q1 + d4 * q2) + i1 * m.u[1]
        + 2 * rolling * vy * (q1 * q4 - q2 * q3)
        + rolling * vx * (q1**2 + q3**2 - q2**2 - q4**2)
    )
    moved = rolling * (vx * (q1 * q2 - q3 * q4) + vy * (q1 * q3 + q2 * q4))
    spun = it2 * (-d1 * q4 + d2 * q3 - d3 * q2 + d4 * q1)
    return moved + spun, np.array([first, second, -moved + spun])


def body_rate_below_eq_12(m: Motions) -> Residuals:
    """A factor of two is missing."""
    (q1, q2, q3, q4), (d1, d2, d3, d4) = m.q, m.dq
    given = -d1 * q4 + d2 * q3 - d3 * q2 + d4 * q1
    return given - m.body[:, 2], 2.0 * given - m.body[:, 2]


def eq_19(_: Motions) -> Residuals:
    """The second row needs the sign of Eq. (18)."""
    q3, q4 = np.random.default_rng(1).uniform(-0.7, 0.7, size=(2, 50))
    q1, q2 = np.sqrt(0.5 - q4**2), np.sqrt(0.5 - q3**2)
    east = 2 * RADIUS * (q3 * q1 - q4 * q2)
    printed, corrected = (
        np.hypot(east, -2 * RADIUS * (q2 * q1 + sign * q3 * q4)) - RADIUS for sign in (-1.0, 1.0)
    )
    return printed, corrected


@pytest.mark.parametrize("equation", [eq_4, eq_10, eq_12, body_rate_below_eq_12, eq_19])
def test_printed_equation_leaves_residuals_and_the_corrected_one_none(
    equation: Callable[[Motions], Residuals]
) -> None:
    printed, corrected = equation(Motions())
    assert np.max(np.abs(printed)) > FAILS
    assert np.max(np.abs(corrected)) < HOLDS


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
    across = np.array([-np.sin(alpha + phi), np.cos(alpha + phi)])
    corrected, misprinted = (
        make_state((0.0, 0.0), box_1(alpha, phi, sign)) for sign in (-1.0, 1.0)
    )
    astray, along = [], []
    for u in np.random.default_rng(2).uniform(-100, 100, size=(20, 2)):
        dx, _ = rates(corrected, u)
        assert abs(dx[:2] @ across) < HOLDS
        along.append(np.linalg.norm(dx[:2]))
        # The paper's own expressions for the velocity, up to a common factor.
        vx = u[1] * np.cos(alpha) + u[0] * np.sin(alpha)
        vx += u[1] * np.cos(alpha + 2 * phi) - u[0] * np.sin(alpha + 2 * phi)
        vy = u[1] * np.sin(alpha) - u[0] * np.cos(alpha)
        vy += u[0] * np.cos(alpha + 2 * phi) + u[1] * np.sin(alpha + 2 * phi)
        assert abs(vx * dx[1] - vy * dx[0]) < HOLDS * 1e3  # products of 200 rad/s and 5 m/s
        astray.append(abs(rates(misprinted, u)[0][:2] @ across))
    assert max(along) > FAILS
    assert max(astray) > FAILS


@pytest.mark.parametrize(("alpha", "phi"), ANGLES)
def test_on_gamma_one_input_spins_in_place_as_remark_1_says(alpha: float, phi: float) -> None:
    x = make_state((0.0, 0.0), box_1(alpha, phi, -1.0))
    columns = np.column_stack([rates(x, u)[0][:2] for u in np.eye(2)])
    assert abs(np.linalg.det(columns)) < HOLDS
    dx, body = rates(x, 100.0 * np.linalg.svd(columns)[2][1])
    np.testing.assert_allclose(dx[:2], 0.0, atol=HOLDS)
    spin = to_world(x) @ body
    np.testing.assert_allclose(spin[:2], 0.0, atol=HOLDS * 10.0)
    assert abs(spin[2]) > 0.1


def upright(heading: float = 0.0, x: float = 0.0) -> Vector:
    return upright_state(x, 0.0, heading)


def moved(start: Vector, knots: Vector | list[Vector]) -> list[Vector]:
    """Return the states at the knots of a first-order hold from rest, one a sample period."""
    plant = RollingPlant(ROBOT, start)
    states = [plant.state]
    for knot in knots:
        plant.advance(knot, PERIOD)
        states.append(plant.state)
    return states


def square(state: Vector, goal: Vector) -> float:
    """Return ||x - x_d||^2."""
    return float(np.sum((state - goal) ** 2))


def value(states: list[Vector], knots: Vector | list[Vector], goal: Vector) -> float:
    """Return the cost of Eq. (24) with the weights of Eq. (34)."""
    pairs = zip(states[:-1], knots, strict=True)
    stages = sum(square(x, goal) + ALPHA * float(u @ u) for x, u in pairs)
    return stages + BETA * square(states[-1], goal)


def test_no_step_comes_nearer_where_only_the_heading_of_an_upright_sphere_is_wrong() -> None:
    """Assumption 3 asks for one that does; without it Theorem 2 fails for any beta."""
    rng = np.random.default_rng(4)
    gain = ROBOT.lumped.input_gain
    start = upright()
    for heading in (0.03, 0.5, 1.5, 2.5, 3.1):
        goal = upright(heading)
        for u in rng.uniform(-100.0, 100.0, size=(20, 2)):
            _, after = moved(start, [u])
            # It rolls straight, by the angle theta about a horizontal axis.
            angle = gain * np.linalg.norm(u) * PERIOD / 2.0
            expected = np.cos(angle / 2) * np.cos(heading / 2)
            assert after[2:] @ goal[2:] == pytest.approx(expected, abs=1e-9)
            assert np.linalg.norm(after[:2]) == pytest.approx(RADIUS * angle, abs=1e-9)
            delta = square(after, goal) - square(start, goal)
            assert delta > 0.0
            assert BETA * delta + square(start, goal) + ALPHA * float(u @ u) > 0.0


def test_eq_41_needs_the_present_state_in_its_last_bound() -> None:
    """V1* is at most V_f of the state itself, and above V_f of the state that it leads to."""
    axis = np.linspace(-100.0, 100.0, 21)
    grid = np.array([[first, second] for first in axis for second in axis])
    for heading, x in ((0.0, 0.5), (0.4, 1.0), (1.0, -0.3)):
        start, goal = upright(x=x), upright(heading)
        reached = [moved(start, [u]) for u in grid]
        costs = [value(states, [u], goal) for states, u in zip(reached, grid, strict=True)]
        best = int(np.argmin(costs))
        assert costs[best] > BETA * square(reached[best][1], goal) + FAILS
        assert costs[best] < BETA * square(start, goal) - FAILS


def test_constant_acceleration_does_not_give_the_constant_torque_of_remark_3() -> None:
    """Eq. (45) contains the angular acceleration of the shell."""
    inertia, steps = ROBOT.rotor_axial_inertia, 2000
    slope = np.array([300.0, -150.0])
    x = make_state((0.0, 0.0), box_1(0.7, 0.3, -1.0))
    plant, torques, rotors = RollingPlant(ROBOT, x), [], []
    for step in range(1, steps + 1):
        u = slope * PERIOD * step / steps
        plant.advance(u, PERIOD / steps)
        torques.append(plant.rotor_torques)
        rotors.append(u + rates(plant.state, u)[1][:2])
    spread = np.ptp(torques, axis=0)
    assert np.max(spread / np.abs(inertia * slope)) > FAILS
    # With it they are the change of the rotors' momenta about their axes.
    change = inertia * np.gradient(np.array(rotors), PERIOD / steps, axis=0)
    np.testing.assert_allclose(np.array(torques)[1:-1], change[1:-1], atol=1e-4)


def test_resting_in_the_neighbourhood_costs_n_plus_beta_times_the_square() -> None:
    goal, still = upright(), np.zeros((HORIZON, 2))
    for size in (1e-3, 9e-3):
        cost = value(moved(upright(x=size), still), still, goal)
        assert cost == pytest.approx((HORIZON + BETA) * size**2, rel=1e-12)
        assert cost != pytest.approx((HORIZON - 1 + BETA) * size**2, rel=1e-9)
        assert cost != pytest.approx((HORIZON - 1 + BETA) * size, rel=0.5)


def test_cost_of_resting_allows_to_leave_the_neighbourhood_however_large_beta_is() -> None:
    """l >= e^2 bounds the error of the next samples by sqrt(N + beta) epsilon only."""
    goal, little = upright(), 1.9
    start = moved(goal, np.array([[0.0, little], [0.0, 0.0]]))[-1]
    assert 0.9 * NEIGHBOURHOOD < np.sqrt(square(start, goal)) < NEIGHBOURHOOD
    # Along one line: on by 16 cm, back, and to the goal.
    knots = np.array([[0.0, 60.0], [0.0, -little], [0.0, -60.0], [0.0, 0.0]])
    states = moved(start, knots)
    assert value(states, knots, goal) < (HORIZON + BETA) * square(start, goal)
    largest = max(np.sqrt(square(state, goal)) for state in states)
    assert largest > 10.0 * NEIGHBOURHOOD
    assert largest < np.sqrt((HORIZON + BETA) * square(start, goal))


def test_every_test_named_in_the_table_of_errata_exists() -> None:
    root = Path(__file__).parents[3]
    named = set(re.findall(r"`(test_\w+)`", (root / "msg_docs/conventions.md").read_text()))
    source = "".join(path.read_text() for path in (root / "test").rglob("test_*.py"))
    assert named
    assert not {name for name in named if f"def {name}(" not in source}
