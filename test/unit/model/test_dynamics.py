# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The CasADi model against a momentum balance of all bodies, and against the plant."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from robots import HEAVY_ROTORS
from scipy.spatial.transform import Rotation

from sphere_nmpc.model.disturbance import imbalance_of_offset
from sphere_nmpc.model.dynamics import state_rate, world_rate
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, contact_points
from sphere_sim.world.plant.rolling_plant import RollingPlant

TABLE_1 = RobotParameters()
BOTH = pytest.mark.parametrize("robot", [TABLE_1, HEAVY_ROTORS], ids=["table 1", "heavy rotors"])

ROUNDING = 1e-12
"""Relative; a few hundred operations in double precision."""


def draws(number: int, seed: int) -> list[tuple[Vector, Vector]]:
    """Return random states and rotor speeds."""
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(number, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return [
        (np.concatenate((rng.uniform(-3, 3, 2), q)), rng.uniform(-100.0, 100.0, 2))
        for q in quaternions
    ]


def rate(robot: RobotParameters, x: Vector, u: Vector) -> Vector:
    return np.array(_rate_function()(x, u, robot.lumped.as_array())).ravel()


@cache
def _rate_function() -> ca.Function:
    x, u, p = ca.SX.sym("x", 6), ca.SX.sym("u", 2), ca.SX.sym("p", 4)
    return ca.Function("rate", [x, u, p], [state_rate(x, u, p)])


def to_world(x: Vector) -> Vector:
    """Return the rotation matrix by SciPy, from body to world, shape (3, 3)."""
    return Rotation.from_quat(x[[3, 4, 5, 2]]).as_matrix()


def spin_of(x: Vector, rate: Vector) -> Vector:
    """Return the angular velocity in the world, 2 q' q*, from the rate of the quaternion."""
    w, v, dw, dv = x[2], x[3:], rate[2], rate[3:]
    return 2.0 * (w * dv - dw * v - np.cross(dv, v))


def momentum_about_contact(robot: RobotParameters, x: Vector, u: Vector, rate: Vector) -> Vector:
    """Add up the angular momenta of the five bodies about the contact point (Eqs. 8 to 10).

    Each body has its spin and the momentum of its own centre, which moves with the sphere's
    centre and turns about it; nothing of the lumped constants is used. World frame, shape (3,).
    """
    turn, spin = to_world(x), spin_of(x, rate)
    velocity = np.array([rate[0], rate[1], 0.0])
    centre = np.array([0.0, 0.0, robot.shell_radius])
    total = robot.shell_inertia * spin + np.cross(centre, robot.shell_mass * velocity)
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


@BOTH
def test_rate_agrees_with_the_independent_plant(robot: RobotParameters) -> None:
    for x, u in draws(200, 1):
        expected = np.array(RollingPlant(robot, x).rate((*x, 0.0, 0.0, 0.0), *u)[:6])
        np.testing.assert_allclose(
            rate(robot, x, u), expected, atol=ROUNDING * np.linalg.norm(expected)
        )


@BOTH
def test_momentum_of_all_bodies_about_the_contact_point_is_zero(robot: RobotParameters) -> None:
    for x, u in draws(100, 3):
        found = rate(robot, x, u)
        # Beside the spin of the rotors alone, of which it is the difference.
        scale = robot.rotor_axial_inertia * np.linalg.norm(u)
        total = momentum_about_contact(robot, x, u, found)
        np.testing.assert_allclose(total, 0.0, atol=ROUNDING * scale)
    # The sum depends on the motion.
    assert np.linalg.norm(momentum_about_contact(robot, x, u, 1.01 * found)) > 1e-3 * scale


def test_rate_with_momentum_satisfies_the_balance_of_all_bodies() -> None:
    """Without momentum and offset of the centre of mass it is the rate of the paper's model."""
    robot = HEAVY_ROTORS
    p, mass, radius = robot.lumped.as_array(), robot.total_mass, robot.shell_radius
    rng, spin_inertia = np.random.default_rng(12), robot.rotor_axial_inertia

    def rate_with(x: Vector, u: Vector, momentum: Vector, imbalance: Vector) -> Vector:
        arguments = (ca.DM(each) for each in (x[2:6], momentum, u, p, imbalance))
        return np.array(world_rate(*arguments)).ravel()

    for x, u in draws(50, 13):
        plain = rate_with(x, u, np.zeros(3), np.zeros(3))
        np.testing.assert_allclose(plain, spin_of(x, rate(robot, x, u)), atol=ROUNDING * 10)

        momentum, c = rng.uniform(-40.0, 40.0, 3), rng.uniform(-0.01, 0.01, 3)
        found = rate_with(x, u, momentum, imbalance_of_offset(robot, c))
        turn = to_world(x)
        inertia = np.diag([robot.transverse_inertia] * 2 + [robot.axial_inertia])
        arm, offset = np.array([0.0, 0.0, radius]), turn @ c
        centre = np.cross(found, arm)
        total = (
            turn @ inertia @ turn.T @ found + spin_inertia * (turn @ np.append(u, 0.0))
            + mass * (np.cross(offset, centre) + np.cross(arm, centre + np.cross(found, offset)))
        )
        np.testing.assert_allclose(total, spin_inertia * momentum, atol=1e-12)


def test_contact_point_agrees_with_eq_18_and_with_the_rotation() -> None:
    radius = TABLE_1.shell_radius
    for x, _ in draws(50, 22):
        q1, q2, q3, q4 = x[2:6]
        printed = radius * np.array([
            2 * (q1 * q3 - q2 * q4), -2 * (q1 * q2 + q3 * q4), q2**2 + q3**2 - q1**2 - q4**2,
        ])
        found = contact_points(x, radius)
        np.testing.assert_allclose(found, printed, atol=1e-15)
        np.testing.assert_allclose(found, to_world(x).T @ [0, 0, -radius], atol=1e-15)
