# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The ideal plant: accuracy, conserved quantities and its interface."""

import numpy as np
import pytest
from other_robots import ROBOTS, states
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, as_state, without_momentum
from sphere_sim.world.plant import rolling_plant
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
START = as_state([1.0, -2.0, 0.1, 0.7, -0.1, 0.7])
FULL = np.array([100.0, -100.0])


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
            return np.array(plant.rate(tuple(y), *u))

        begun = without_momentum(start)
        found = solve_ivp(rate, (0.0, 0.5), begun, method="DOP853", rtol=1e-12, atol=1e-12)
        worst = max(worst, float(np.max(np.abs(plant.state - found.y[:6, -1]))))
    assert worst < 1e-6


def test_norm_momentum_and_contact_stay_as_they_are_over_a_long_run() -> None:
    plant = RollingPlant(ROBOT, START)
    rng = np.random.default_rng(2)
    arm = np.array([0.0, 0.0, ROBOT.shell_radius])
    inertia = np.diag([ROBOT.transverse_inertia] * 2 + [ROBOT.axial_inertia])
    for _ in range(60):
        plant.advance(rng.uniform(-100.0, 100.0, 2), 0.5)
        turn, u = Rotation.from_quat(plant.state[[3, 4, 5, 2]]).as_matrix(), plant.rotor_speeds
        # The bodies' spin about the centre, then the rolling of all the mass about the contact.
        spin = inertia @ plant.body_rate + ROBOT.rotor_axial_inertia * np.append(u, 0.0)
        total = turn @ spin + np.cross(arm, ROBOT.total_mass * plant.velocity)
        # Rounding beside rotors that carry up to 1 N m s.
        np.testing.assert_allclose(total, 0.0, atol=1e-14)
        slip = plant.velocity - np.cross(turn @ plant.body_rate, arm)
        np.testing.assert_allclose(slip, 0.0, atol=1e-14)
        assert abs(np.linalg.norm(plant.state[2:6]) - 1.0) < 1e-15 * 4


def test_velocity_and_torque_agree_with_what_is_seen_from_outside() -> None:
    plant, slope, h = RollingPlant(ROBOT, START), np.array([300.0, -150.0]), 1e-6
    plant.advance(FULL, 0.5)
    plant.advance(plant.rotor_speeds + slope * 0.1, 0.1)
    torque, rate, state, velocity = (
        plant.rotor_torques, plant.body_rate, plant.state, plant.velocity
    )
    plant.advance(plant.rotor_speeds + slope * h, h)
    # The limit of Eq. (46); first order in h.
    expected = ROBOT.rotor_axial_inertia * ((plant.body_rate - rate)[:2] / h + slope)
    np.testing.assert_allclose(torque, expected, atol=1e-5)
    np.testing.assert_allclose((plant.state - state)[:2] / h, velocity[:2], atol=1e-3)
    assert velocity[2] == 0.0


def test_torque_from_rest_in_an_upright_sphere_agrees_with_hand_calculation() -> None:
    plant = RollingPlant(ROBOT, as_state([0, 0, 1, 0, 0, 0]))
    plant.advance(np.array([4e-6, 0.0]), 1e-8)  # 400 rad/s^2
    # The shell turns the other way by c1 = 0.008 / 0.4575 of it: 0.008 * 400 * (1 - c1) N m.
    np.testing.assert_allclose(
        plant.rotor_torques, [3.2 * (1 - 0.008 / 0.4575), 0.0], atol=1e-9
    )


def test_rotors_have_angles_and_are_stopped_by_reset_and_not_by_displace() -> None:
    plant = RollingPlant(ROBOT, START)
    plant.advance(np.array([40.0, -10.0]), 0.5)
    plant.advance(np.array([0.0, 20.0]), 0.25)
    plant.displace(START)
    np.testing.assert_array_equal(plant.state, START)
    np.testing.assert_allclose(plant.rotor_angles, [10.0 + 5.0, -2.5 + 1.25], atol=1e-12)
    np.testing.assert_array_equal(plant.rotor_speeds, [0.0, 20.0])
    plant.reset(START)
    for still in (plant.rotor_speeds, plant.rotor_angles, plant.velocity, plant.rotor_torques):
        assert not np.any(still)


@pytest.mark.parametrize("name", ROBOTS)
def test_steps_of_the_rolling_plant_are_short_enough(monkeypatch, name) -> None:
    robot, start = ROBOTS[name], as_state([0.0, 0.0, 0.03, 0.454, 0.88, 0.1363])
    limit = robot.max_rotor_speed
    knots = np.random.default_rng(0).uniform(-limit, limit, (6, 2))
    ramp = 2.0 * limit / robot.max_rotor_acceleration
    usual = states(RollingPlant(robot, start), knots, ramp)
    monkeypatch.setattr(rolling_plant, "MAX_STEP", 5e-4)
    fine = states(RollingPlant(robot, start), knots, ramp)
    np.testing.assert_allclose(usual[:, :2], fine[:, :2], atol=1e-5 * robot.shell_radius)
    np.testing.assert_allclose(usual[:, 2:], fine[:, 2:], atol=1e-5)
