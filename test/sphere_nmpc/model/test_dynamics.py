# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The CasADi model against a momentum balance of all bodies, and against the plant."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from robots import HEAVY_ROTORS
from scipy.spatial.transform import Rotation

from sphere_nmpc.model.drift import imbalance_of_offset
from sphere_nmpc.model.dynamics import (
    body_rate,
    rotor_torque,
    state_rate,
    world_rate,
    world_rate_with_momentum,
)
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, contact_points
from sphere_nmpc.model.symbolic_rotation import quaternion_product
from sphere_sim.world.plant.rolling_plant import RollingPlant

TABLE_1 = RobotParameters()

ROUNDING = 1e-12
"""Relative; a few hundred operations in double precision."""


def random_states(number: int, seed: int) -> list[Vector]:
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(number, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return [np.concatenate((rng.uniform(-3, 3, 2), q)) for q in quaternions]


def random_speeds(number: int, seed: int) -> Vector:
    return np.random.default_rng(seed).uniform(-100.0, 100.0, size=(number, 2))


def column(expression: ca.DM) -> Vector:
    return np.array(expression).ravel()


def rate(robot: RobotParameters, x: Vector, u: Vector) -> Vector:
    return column(_rate_function()(x, u, robot.lumped.as_array()))


@cache
def _rate_function() -> ca.Function:
    x, u, p = ca.SX.sym("x", 6), ca.SX.sym("u", 2), ca.SX.sym("p", 4)
    return ca.Function("rate", [x, u, p], [state_rate(x, u, p)])


def to_world(x: Vector) -> Vector:
    """Return the rotation matrix by SciPy, from body to world, shape (3, 3)."""
    return Rotation.from_quat(x[[3, 4, 5, 2]]).as_matrix()


def momentum_about_contact(robot: RobotParameters, x: Vector, u: Vector, rate: Vector) -> Vector:
    """Add up the angular momenta of the five bodies about the contact point (Eqs. 8 to 10).

    Each body has its spin and the momentum of its own centre, which moves with the sphere's
    centre and turns about it; nothing of the lumped constants is used. World frame, shape (3,).
    """
    turn = to_world(x)
    spin = 2.0 * column(
        quaternion_product(ca.DM(rate[2:6]), ca.DM(x[2:6] * [1, -1, -1, -1]))
    )[1:4]
    velocity = np.array([rate[0], rate[1], 0.0])
    centre = np.array([0.0, 0.0, robot.shell_radius])
    shell = robot.shell_inertia * spin + np.cross(centre, robot.shell_mass * velocity)
    total = shell
    for axis in range(2):
        for side, mass, axial, across, speed in (
            (1.0, robot.rotor_mass, robot.rotor_axial_inertia,
             robot.rotor_transverse_inertia, u[axis]),
            (-1.0, robot.counterweight_mass, robot.counterweight_axial_inertia,
             robot.counterweight_transverse_inertia, 0.0),
        ):
            direction = np.eye(3)[axis]
            inertia = np.diag(np.where(direction > 0.0, axial, across))
            own_spin = turn.T @ spin + speed * direction
            arm = turn @ (side * robot.rotor_offset * direction)
            moving = mass * (velocity + np.cross(spin, arm))
            total = total + turn @ inertia @ own_spin + np.cross(centre + arm, moving)
    return total


@pytest.mark.parametrize("robot", [TABLE_1, HEAVY_ROTORS])
def test_rate_agrees_with_the_independent_plant(robot: RobotParameters) -> None:
    for x, u in zip(random_states(200, 1), random_speeds(200, 2), strict=True):
        plant = RollingPlant(robot, x)
        expected = np.array(plant._rate(tuple(x), *u))
        np.testing.assert_allclose(
            rate(robot, x, u), expected, atol=ROUNDING * np.linalg.norm(expected)
        )


@pytest.mark.parametrize("robot", [TABLE_1, HEAVY_ROTORS])
def test_momentum_of_all_bodies_about_the_contact_point_is_zero(robot: RobotParameters) -> None:
    for x, u in zip(random_states(200, 3), random_speeds(200, 4), strict=True):
        total = momentum_about_contact(robot, x, u, rate(robot, x, u))
        # Beside the spin of the rotors alone, of which it is the difference.
        scale = robot.rotor_axial_inertia * np.linalg.norm(u)
        np.testing.assert_allclose(total, 0.0, atol=ROUNDING * scale)


def test_momentum_sum_depends_on_the_motion() -> None:
    x, u = random_states(1, 5)[0], np.array([30.0, -80.0])
    wrong = 1.01 * rate(TABLE_1, x, u)
    scale = TABLE_1.rotor_axial_inertia * np.linalg.norm(u)
    assert np.linalg.norm(momentum_about_contact(TABLE_1, x, u, wrong)) > 1e-3 * scale


def test_contact_point_is_at_rest() -> None:
    p = TABLE_1.lumped.as_array()
    for x, u in zip(random_states(100, 6), random_speeds(100, 7), strict=True):
        spin = column(world_rate(ca.DM(x[2:6]), ca.DM(u), p))
        velocity = np.append(rate(TABLE_1, x, u)[:2], 0.0)
        slip = velocity + np.cross(spin, [0.0, 0.0, -TABLE_1.shell_radius])
        np.testing.assert_allclose(slip, 0.0, atol=ROUNDING * 10.0)  # speeds of up to 10 m/s


def test_rate_keeps_the_quaternion_on_the_unit_sphere() -> None:
    for x, u in zip(random_states(100, 8), random_speeds(100, 9), strict=True):
        assert abs(x[2:6] @ rate(TABLE_1, x, u)[2:6]) < ROUNDING * 10.0


def test_world_and_body_rate_are_one_vector_in_two_frames() -> None:
    p = TABLE_1.lumped.as_array()
    for x, u in zip(random_states(50, 10), random_speeds(50, 11), strict=True):
        q = ca.DM(x[2:6])
        expected = to_world(x) @ column(body_rate(q, ca.DM(u), p))
        np.testing.assert_allclose(column(world_rate(q, ca.DM(u), p)), expected, atol=1e-11)


def test_rate_with_momentum_satisfies_the_balance_of_all_bodies() -> None:
    """Without momentum and offset of the centre of mass it is the rate of the paper's model."""
    robot = HEAVY_ROTORS
    p, mass, radius = robot.lumped.as_array(), robot.total_mass, robot.shell_radius
    rng, spin_inertia = np.random.default_rng(12), robot.rotor_axial_inertia
    for x, u in zip(random_states(50, 12), random_speeds(50, 13), strict=True):
        q, zero = ca.DM(x[2:6]), np.zeros(3)
        plain = column(world_rate_with_momentum(q, ca.DM(u), p, zero, zero))
        np.testing.assert_allclose(plain, column(world_rate(q, ca.DM(u), p)), atol=ROUNDING * 10)

        momentum, c = rng.uniform(-40.0, 40.0, 3), rng.uniform(-0.01, 0.01, 3)
        found = column(
            world_rate_with_momentum(q, ca.DM(u), p, momentum, imbalance_of_offset(robot, c))
        )
        turn = to_world(x)
        inertia = np.diag([robot.transverse_inertia] * 2 + [robot.axial_inertia])
        arm, offset = np.array([0.0, 0.0, radius]), turn @ c
        centre = np.cross(found, arm)
        total = (
            turn @ inertia @ turn.T @ found + spin_inertia * (turn @ np.append(u, 0.0))
            + mass * (np.cross(offset, centre) + np.cross(arm, centre + np.cross(found, offset)))
        )
        np.testing.assert_allclose(total, spin_inertia * momentum, atol=1e-12)


def test_rate_is_the_same_everywhere_on_the_plane() -> None:
    x, u = random_states(1, 13)[0], np.array([70.0, -20.0])
    moved = x + np.array([12.0, -7.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(rate(TABLE_1, moved, u), rate(TABLE_1, x, u))


def test_rate_turns_with_the_world_about_the_vertical() -> None:
    for angle, x, u in zip(
        np.linspace(-3.0, 3.0, 20), random_states(20, 14), random_speeds(20, 15), strict=True
    ):
        heading = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
        plane = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

        def turned(
            y: Vector, heading: Vector = heading, plane: Vector = plane
        ) -> Vector:
            q = column(quaternion_product(ca.DM(heading), ca.DM(y[2:6])))
            return np.concatenate((plane @ y[:2], q))

        np.testing.assert_allclose(
            rate(TABLE_1, turned(x), u), turned(rate(TABLE_1, x, u)), atol=1e-11
        )


def test_rate_turns_with_the_body_about_its_axis_between_the_rotors() -> None:
    angle = 0.8
    turn = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
    back = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    for x, u in zip(random_states(20, 16), random_speeds(20, 17), strict=True):
        y = np.concatenate((x[:2], column(quaternion_product(ca.DM(x[2:6]), ca.DM(turn)))))
        np.testing.assert_allclose(
            rate(TABLE_1, y, back @ u)[:2], rate(TABLE_1, x, u)[:2], atol=1e-11
        )


def test_rate_is_linear_in_the_input_so_that_time_can_run_backwards() -> None:
    for x, u, v in zip(
        random_states(30, 18), random_speeds(30, 19), random_speeds(30, 20), strict=True
    ):
        both = rate(TABLE_1, x, 0.3 * u - 2.0 * v)
        apart = 0.3 * rate(TABLE_1, x, u) - 2.0 * rate(TABLE_1, x, v)
        np.testing.assert_allclose(both, apart, atol=1e-11)
        np.testing.assert_array_equal(rate(TABLE_1, x, -u), -rate(TABLE_1, x, u))
    np.testing.assert_array_equal(rate(TABLE_1, x, np.zeros(2)), np.zeros(6))


def test_opposite_quaternions_are_one_orientation() -> None:
    x, u = random_states(1, 21)[0], np.array([-40.0, 90.0])
    opposite = x * np.array([1, 1, -1, -1, -1, -1])
    there, here = rate(TABLE_1, opposite, u), rate(TABLE_1, x, u)
    np.testing.assert_allclose(there, here * [1, 1, -1, -1, -1, -1], atol=1e-13)


def test_contact_point_agrees_with_eq_18_and_with_the_rotation() -> None:
    radius = TABLE_1.shell_radius
    for x in random_states(50, 22):
        q1, q2, q3, q4 = x[2:6]
        printed = radius * np.array([
            2 * (q1 * q3 - q2 * q4), -2 * (q1 * q2 + q3 * q4), q2**2 + q3**2 - q1**2 - q4**2,
        ])
        found = contact_points(x, radius)
        np.testing.assert_allclose(found, printed, atol=1e-15)
        np.testing.assert_allclose(found, to_world(x).T @ [0, 0, -radius], atol=1e-15)


def test_derivatives_agree_with_finite_differences() -> None:
    x, u, p = ca.SX.sym("x", 6), ca.SX.sym("u", 2), TABLE_1.lumped.as_array()
    value = state_rate(x, u, p)
    jacobian = ca.Function("jacobian", [x, u], [ca.jacobian(value, ca.vertcat(x, u))])
    for at, speeds in zip(random_states(20, 23), random_speeds(20, 24), strict=True):
        exact = np.array(jacobian(at, speeds))
        point = np.concatenate((at, speeds))
        h = 1e-6
        for i in range(8):
            ahead, behind = point.copy(), point.copy()
            ahead[i], behind[i] = point[i] + h, point[i] - h
            slope = (
                rate(TABLE_1, ahead[:6], ahead[6:]) - rate(TABLE_1, behind[:6], behind[6:])
            ) / (2 * h)
            # Rates reach 10, so rounding leaves 1e-15 * 10 / 1e-6; h^2 adds far less.
            np.testing.assert_allclose(exact[:, i], slope, atol=1e-7)


def test_rotor_torque_agrees_with_the_plant_and_with_the_paper_finite_difference() -> None:
    p, inertia = TABLE_1.lumped.as_array(), TABLE_1.rotor_axial_inertia
    rng = np.random.default_rng(25)
    for x in random_states(20, 26):
        start, end, period = rng.uniform(-60, 60, 2), rng.uniform(-60, 60, 2), 1e-4
        plant = RollingPlant(TABLE_1, x)
        plant._speeds = start
        plant.advance(end, 0.5)
        slope = (end - start) / 0.5
        exact = column(rotor_torque(ca.DM(plant.state[2:6]), end, slope, p, inertia))
        # The plant differentiates numerically: a second difference of 1e-6 s.
        np.testing.assert_allclose(exact, plant.rotor_torques, atol=1e-6)

        # Eqs. (45) and (46) over a short interval; they are of first order in its length.
        begin = plant.body_rate
        plant.advance(end + slope * period, period)
        printed = inertia * ((plant.body_rate - begin)[:2] / period + slope)
        np.testing.assert_allclose(exact, printed, atol=2e-2 * np.abs(exact).max())


def test_finite_difference_of_torque_over_half_a_second_is_only_an_estimate() -> None:
    p, inertia = TABLE_1.lumped.as_array(), TABLE_1.rotor_axial_inertia
    misses = []
    for x, end in zip(random_states(30, 27), random_speeds(30, 28), strict=True):
        plant = RollingPlant(TABLE_1, x)
        begin = plant.body_rate
        plant.advance(end, 0.5)
        printed = inertia * ((plant.body_rate - begin)[:2] / 0.5 + end / 0.5)
        exact = column(rotor_torque(ca.DM(plant.state[2:6]), end, end / 0.5, p, inertia))
        misses.append(np.max(np.abs(printed - exact)))
    # Of torques of up to 1.6 N m; the motion of the shell adds little to that of the rotors.
    assert 1e-2 < max(misses) < 0.2, max(misses)
