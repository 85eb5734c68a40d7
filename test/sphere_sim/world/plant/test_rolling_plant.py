# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The ideal plant: accuracy, conserved quantities and its interface."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, as_state
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
START = as_state([1.0, -2.0, 0.1, 0.7, -0.1, 0.7])
FULL = np.array([100.0, -100.0])


def random_run(plant: RollingPlant, seconds: float, seed: int = 0) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(round(seconds / 0.5)):
        plant.advance(rng.uniform(-100.0, 100.0, 2), 0.5)


def to_world(state: Vector) -> Vector:
    return Rotation.from_quat(state[[3, 4, 5, 2]]).as_matrix()


def test_interval_at_full_speed_agrees_with_an_adaptive_integrator() -> None:
    worst = 0.0
    rng = np.random.default_rng(1)
    for _ in range(10):
        q = rng.normal(size=4)
        start = np.concatenate((np.zeros(2), q / np.linalg.norm(q)))
        u = 100.0 * rng.choice([-1.0, 1.0], 2)
        plant = RollingPlant(ROBOT, start)
        plant._speeds = u
        plant.advance(u, 0.5)

        def rate(_: float, y: Vector, u: Vector = u, plant: RollingPlant = plant) -> Vector:
            return np.array(plant._rate(tuple(y), *u))

        found = solve_ivp(rate, (0.0, 0.5), start, method="DOP853", rtol=1e-12, atol=1e-12)
        worst = max(worst, float(np.max(np.abs(plant.state - found.y[:, -1]))))
    assert worst < 1e-6


def test_unit_norm_is_kept_to_rounding_over_a_long_run() -> None:
    plant = RollingPlant(ROBOT, START)
    random_run(plant, 60.0)
    assert abs(np.linalg.norm(plant.state[2:6]) - 1.0) < 1e-15 * 4


def test_momentum_about_the_contact_point_stays_zero_over_a_long_run() -> None:
    plant = RollingPlant(ROBOT, START)
    rng = np.random.default_rng(2)
    for _ in range(60):
        plant.advance(rng.uniform(-100.0, 100.0, 2), 0.5)
        turn, u = to_world(plant.state), plant.rotor_speeds
        # The bodies' spin about the centre, then the rolling of all the mass about the contact.
        inertia = np.diag([ROBOT.transverse_inertia] * 2 + [ROBOT.axial_inertia])
        spin = inertia @ plant.body_rate + ROBOT.rotor_axial_inertia * np.append(u, 0.0)
        arm = np.array([0.0, 0.0, ROBOT.shell_radius])
        total = turn @ spin + np.cross(arm, ROBOT.total_mass * plant.velocity)
        # Rounding beside rotors that carry up to 1 N m s.
        np.testing.assert_allclose(total, 0.0, atol=1e-14)


def test_contact_point_has_no_velocity_during_a_run() -> None:
    plant = RollingPlant(ROBOT, START)
    rng = np.random.default_rng(3)
    for _ in range(20):
        plant.advance(rng.uniform(-100.0, 100.0, 2), 0.1)
        spin = to_world(plant.state) @ plant.body_rate
        slip = plant.velocity + np.cross(spin, [0.0, 0.0, -ROBOT.shell_radius])
        np.testing.assert_allclose(slip, 0.0, atol=1e-14)


def test_velocity_is_the_derivative_of_the_position() -> None:
    plant = RollingPlant(ROBOT, START)
    plant.advance(FULL, 0.3)
    before, velocity, h = plant.state, plant.velocity, 1e-5
    plant.advance(FULL, h)
    after = plant.state
    # First order in h: half the acceleration, below 100 m/s^2, times h.
    np.testing.assert_allclose((after - before)[:2] / h, velocity[:2], atol=1e-3)
    assert velocity[2] == 0.0


def test_rotor_angle_is_the_integral_of_its_speed() -> None:
    plant = RollingPlant(ROBOT, START)
    plant.advance(np.array([40.0, -10.0]), 0.5)
    plant.advance(np.array([0.0, 20.0]), 0.25)
    np.testing.assert_allclose(plant.rotor_angles, [10.0 + 5.0, -2.5 + 1.25], atol=1e-12)
    np.testing.assert_array_equal(plant.rotor_speeds, [0.0, 20.0])


def test_torque_from_rest_in_an_upright_sphere_agrees_with_hand_calculation() -> None:
    plant = RollingPlant(ROBOT, as_state([0, 0, 1, 0, 0, 0]))
    plant.advance(np.array([4e-6, 0.0]), 1e-8)  # 400 rad/s^2
    # The shell turns the other way by c1 = 0.008 / 0.4575 of it: 0.008 * 400 * (1 - c1) N m.
    np.testing.assert_allclose(
        plant.rotor_torques, [3.2 * (1 - 0.008 / 0.4575), 0.0], atol=1e-9
    )


def test_torque_agrees_with_the_acceleration_seen_from_outside() -> None:
    plant = RollingPlant(ROBOT, START)
    random_run(plant, 2.0)
    slope, h = np.array([300.0, -150.0]), 1e-6
    plant.advance(plant.rotor_speeds + slope * 0.1, 0.1)
    torque, before = plant.rotor_torques, plant.body_rate
    plant.advance(plant.rotor_speeds + slope * h, h)
    expected = ROBOT.rotor_axial_inertia * ((plant.body_rate - before)[:2] / h + slope)
    np.testing.assert_allclose(torque, expected, atol=1e-5)  # first order in h


def test_reset_stops_the_rotors_and_displace_does_not() -> None:
    plant = RollingPlant(ROBOT, START)
    random_run(plant, 1.0)
    speeds, angles = plant.rotor_speeds, plant.rotor_angles
    plant.displace(START)
    np.testing.assert_array_equal(plant.state, START)
    np.testing.assert_array_equal(plant.rotor_speeds, speeds)
    np.testing.assert_array_equal(plant.rotor_angles, angles)
    plant.reset(START)
    assert not np.any(plant.rotor_speeds)
    assert not np.any(plant.rotor_angles)
    assert not np.any(plant.velocity)
    assert not np.any(plant.rotor_torques)


@pytest.mark.parametrize("parts", [2, 7, 50])
def test_interval_in_parts_ends_where_the_whole_one_does(parts: int) -> None:
    whole, cut = RollingPlant(ROBOT, START), RollingPlant(ROBOT, START)
    whole.advance(FULL, 0.5)
    for i in range(parts):
        cut.advance(FULL * (i + 1) / parts, 0.5 / parts)
    np.testing.assert_allclose(cut.state, whole.state, atol=1e-7)  # twice the method's error


def test_returned_arrays_are_copies() -> None:
    plant = RollingPlant(ROBOT, START)
    for given in (plant.state, plant.rotor_speeds, plant.rotor_angles):
        given[:] = 99.0
    np.testing.assert_array_equal(plant.state, START)
    assert not np.any(plant.rotor_speeds)
    assert not np.any(plant.rotor_angles)
