# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The CasADi model against a momentum balance of all bodies and the plant, and its integrator."""

from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from motions import integrate
from robots import HEAVY_ROTORS
from scipy.spatial.transform import Rotation

from sphere_nmpc.model.controllability import distance_to_circle
from sphere_nmpc.model.disturbance import imbalance_of_offset
from sphere_nmpc.model.dynamics import state_rate, world_rate
from sphere_nmpc.model.integrator import step_function
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import QUATERNION, Vector, as_state, contact_points, make_state
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROOT = Path(__file__).parents[3]
TABLE_1 = RobotParameters()
P = TABLE_1.lumped.as_array()
BOTH = pytest.mark.parametrize("robot", [TABLE_1, HEAVY_ROTORS], ids=["table 1", "heavy rotors"])

ROUNDING = 1e-12
"""Relative; a few hundred operations in double precision."""
PERIOD = 0.5
"""Sample period of the paper [s]."""


def draws(number: int, seed: int) -> list[tuple[Vector, Vector]]:
    """Return random states and rotor speeds."""
    rng = np.random.default_rng(seed)
    return [
        (make_state(rng.uniform(-3, 3, 2), random_quaternion(rng)), rng.uniform(-100.0, 100.0, 2))
        for _ in range(number)
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
    for direction, rotor_speed in zip(np.eye(3), u, strict=False):
        for side, mass, axial, across, speed in (
            (1.0, robot.rotor_mass, robot.rotor_axial_inertia,
             robot.rotor_transverse_inertia, rotor_speed),
            (-1.0, robot.counterweight_mass, robot.counterweight_axial_inertia,
             robot.counterweight_transverse_inertia, 0.0),
        ):
            inertia = np.diag(np.where(direction > 0.0, axial, across))
            own_spin = turn.T @ spin + speed * direction
            arm = turn @ (side * robot.rotor_offset * direction)
            moving = mass * (velocity + np.cross(spin, arm))
            total = total + turn @ inertia @ own_spin + np.cross(centre + arm, moving)
    return total


@BOTH
def test_rate_is_that_of_the_plant_and_leaves_the_momentum_of_all_bodies_about_the_contact_zero(
    robot: RobotParameters,
) -> None:
    for x, u in draws(200, 1):
        found = rate(robot, x, u)
        expected = np.array(RollingPlant(robot, x).rate((*x, 0.0, 0.0, 0.0), *u)[:6])
        np.testing.assert_allclose(found, expected, atol=ROUNDING * np.linalg.norm(expected))
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


def test_order_of_the_integrator_is_four_and_its_error_in_a_period_is_small() -> None:
    """Figures are in ``docs/model.md``."""
    states = np.column_stack([x for x, _ in draws(500, 0)])
    u_start, u_end = np.random.default_rng(0).uniform(-100.0, 100.0, size=(2, 2, 500))
    many = step_function().map(500)

    def over_one_period(steps: int) -> Vector:
        x = states
        for i in range(steps):
            here, there = (u_start + (u_end - u_start) * (k / steps) for k in (i, i + 1))
            x = np.array(many(x, here, there, PERIOD / steps, P))
        return x

    truth, steps = over_one_period(200), [5, 8, 12, 16, 24, 32]
    errors = [np.linalg.norm(over_one_period(n) - truth, axis=0) for n in steps]
    slope = -np.polyfit(np.log(steps[1:]), np.log(np.median(errors[1:], axis=1)), 1)[0]
    assert 3.7 < slope < 4.3, slope
    # Five steps at the speeds of the paper; twice what 2000 draws gave, as these are fewer.
    assert np.quantile(errors[0], 0.99) < 4e-4


def test_long_run_agrees_with_the_independent_plant_and_keeps_the_unit_norm() -> None:
    rng = np.random.default_rng(2)
    x = as_state([1.0, -2.0, 0.1, 0.7, -0.1, 0.7])
    plant, u = RollingPlant(TABLE_1, x), np.zeros(2)
    for _ in range(20):
        following = rng.uniform(-100, 100, 2)
        x = integrate(x, u, following, PERIOD, P, max_step=0.0125)
        plant.advance(following, PERIOD)
        u = following
    # Both methods make about 1e-7 an interval at full speed, over 20 intervals.
    np.testing.assert_allclose(x, plant.state, atol=5e-6)
    # 800 steps of five exponentials each: a random walk of 1e-16 a factor.
    assert abs(np.linalg.norm(x[QUATERNION]) - 1.0) < 1e-13


def test_motion_runs_backwards_when_the_inputs_do_and_no_time_is_no_motion() -> None:
    start, a, b = as_state([0.3, 0.1, 0.8, 0.6, 0, 0]), np.array([80.0, 10.0]), np.array([-40, 90])
    there = integrate(start, a, b, PERIOD, P, max_step=0.01)
    back = integrate(there, -b, -a, PERIOD, P, max_step=0.01)
    np.testing.assert_allclose(back, start, atol=1e-7)
    np.testing.assert_array_equal(integrate(start, a, b, 0.0, P), start)


@BOTH
def test_fastest_turn_is_about_the_vertical_on_the_circle(robot) -> None:
    """The rate that an IMU needs follows from it, see "Which IMU" in docs/porting.md."""
    lumped, top = robot.lumped, robot.max_rotor_speed
    rolling = np.sqrt(2.0) * lumped.input_gain * top
    fastest = rolling / (1.0 - lumped.transverse_ratio)
    for x, u in draws(300, 8):
        assert np.linalg.norm(spin_of(x, rate(robot, x, np.sign(u) * top))) < fastest * 1.000001
    # The vertical is (1, 1, 0) / sqrt(2) in the body frame: both rotors turn about it at once.
    x = as_state(np.concatenate(([0.0, 0.0], Rotation.align_vectors(
        [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], [[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    )[0].as_quat()[[3, 0, 1, 2]])))
    assert distance_to_circle(x) == pytest.approx(0.0, abs=1e-7)
    turn = spin_of(x, rate(robot, x, np.array([top, top])))
    np.testing.assert_allclose(turn, [0.0, 0.0, -fastest], atol=1e-6 * fastest)
    if robot is TABLE_1:
        document = (ROOT / "docs" / "porting.md").read_text(encoding="utf-8")
        assert f"rolls with {rolling:.1f}\nrad/s and turns with {fastest:.1f} rad/s" in document
        assert f"which takes {round(fastest / 0.03, -1):.0f} Hz" in document
        wrong = fastest**2 * 1e-3
        tilt = np.degrees(np.arctan(wrong / 9.81))
        assert f"by {1e3 * wrong:.0f} mm/s², as much as {tilt:.2f}° of tilt" in document
        assert f"{0.12 * fastest**2:.1f} m/s² at 12 cm" in document
        assert f"rotors of 300 rad/s turns with {3.0 * fastest:.0f} rad/s" in document
        assert 3.0 * fastest / 0.03 == pytest.approx(1e3, rel=0.05)
