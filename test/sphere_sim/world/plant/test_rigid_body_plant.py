# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The plant with contact: agreement with the ideal one, contact, drives and floors."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.dynamics import rotor_torque
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, angle_error, position_error
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.errors import PlantDivergedError
from sphere_sim.world.plant.rolling_plant import RollingPlant

pytest.importorskip("mujoco")
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings

ROBOT = RobotParameters()
ORIGIN = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
IDEAL_DRIVES = RigidBodySettings(
    drive_bandwidth=1e6, drive_feedforward=True, torque_limit=1e3, friction=2.0
)
POSITION_TOLERANCE = 1e-3
"""Deviation allowed after 5 s of random inputs [m]; docs/rigid_body.md has 0.2 mm at worst."""
ANGLE_TOLERANCE = 5e-3
"""The same [rad]; 2 mrad at worst."""
REST = np.zeros(2)


def draw(seed, knots=10):
    """Return a random start, shape (6,), and rotor speeds each 0.5 s, shape (knots, 2)."""
    rng = np.random.default_rng(seed)
    turn = rng.normal(size=4)
    start = np.concatenate((rng.uniform(-3, 3, 2), turn / np.linalg.norm(turn)))
    return start, rng.uniform(-100.0, 100.0, (knots, 2))


def run(plant, speeds, step=0.5):
    here = np.zeros(2)
    for there in speeds:
        for share in np.linspace(0.0, 1.0, round(0.5 / step) + 1)[1:]:
            plant.advance(here + share * (there - here), step)
        here = there
    return plant


def readings(plant):
    return np.concatenate(
        (
            plant.state,
            plant.body_rate,
            plant.velocity,
            plant.rotor_angles,
            plant.rotor_speeds,
            plant.rotor_torques,
        )
    )


@pytest.mark.parametrize("seed", range(5))
def test_follows_the_rolling_plant_with_ideal_drives(seed):
    start, speeds = draw(seed)
    ideal = run(RollingPlant(ROBOT, start), speeds)
    plant = run(RigidBodyPlant(ROBOT, start, IDEAL_DRIVES), speeds)
    assert position_error(plant.state, ideal.state) < POSITION_TOLERANCE
    assert angle_error(plant.state, ideal.state) < ANGLE_TOLERANCE
    np.testing.assert_allclose(plant.body_rate, ideal.body_rate, atol=0.02)
    np.testing.assert_allclose(plant.velocity, ideal.velocity, atol=5e-3)
    np.testing.assert_allclose(plant.rotor_speeds, speeds[-1], atol=0.1)
    np.testing.assert_allclose(plant.rotor_angles, ideal.rotor_angles, atol=0.1)


def test_both_plants_agree_for_perturbed_masses_and_inertias():
    rng = np.random.default_rng(3)
    names = [
        "shell_mass", "shell_radius", "shell_inertia", "counterweight_mass", "rotor_mass",
        "rotor_axial_inertia", "rotor_transverse_inertia",
        "counterweight_axial_inertia", "counterweight_transverse_inertia",
    ]  # fmt: skip
    for seed in range(3):
        factors = rng.uniform(0.8, 1.2, len(names))
        changes = {n: getattr(ROBOT, n) * f for n, f in zip(names, factors, strict=True)}
        robot = replace(ROBOT, **changes)
        start, speeds = draw(seed, knots=4)
        ideal = run(RollingPlant(robot, start), speeds)
        plant = run(RigidBodyPlant(robot, start, IDEAL_DRIVES), speeds)
        assert position_error(plant.state, ideal.state) < POSITION_TOLERANCE
        assert angle_error(plant.state, ideal.state) < ANGLE_TOLERANCE


def test_momentum_about_the_contact_point_stays_zero():
    start, speeds = draw(11)
    plant = RigidBodyPlant(ROBOT, start)
    scale = ROBOT.rotor_axial_inertia * 100.0
    for there in speeds:
        plant.advance(there, 0.5)
        np.testing.assert_allclose(plant.momentum, 0.0, atol=1e-5 * scale)


def test_torque_is_that_of_the_model():
    start, speeds = draw(5, knots=3)
    settings = replace(IDEAL_DRIVES, drive_bandwidth=500.0)
    plant = run(RigidBodyPlant(ROBOT, start, settings), speeds[:2])
    plant.advance(0.5 * (speeds[1] + speeds[2]), 0.25)
    predicted = rotor_torque(
        ca.DM(plant.state[QUATERNION]),
        ca.DM(plant.rotor_speeds),
        ca.DM((speeds[2] - speeds[1]) / 0.5),
        ca.DM(ROBOT.lumped.as_array()),
        ROBOT.rotor_axial_inertia,
    )
    np.testing.assert_allclose(plant.rotor_torques, np.array(predicted).ravel(), atol=2e-3)


def test_torque_stays_within_its_limit_and_the_rotor_lags_behind():
    plant = RigidBodyPlant(ROBOT, ORIGIN, RigidBodySettings(torque_limit=0.8))
    for i in range(10):
        plant.advance(np.array([10.0 * (i + 1), 0.0]), 0.025)
        assert np.all(np.abs(plant.rotor_torques) <= 0.8)
    # A fixed shell would allow 0.8 / I1 = 100 rad/s^2; it gives way by 2 %.
    np.testing.assert_allclose(plant.rotor_speeds, [0.25 * 101.8, 0.0], atol=0.5)


def test_servo_lags_by_its_time_constant_on_a_ramp():
    settings = RigidBodySettings(drive_bandwidth=50.0)
    plant = RigidBodyPlant(ROBOT, ORIGIN, settings)
    plant.advance(np.array([50.0, 0.0]), 0.5)
    assert plant.rotor_speeds[0] == pytest.approx(50.0 - 100.0 / 50.0, abs=0.1)


def test_two_runs_are_equal_to_the_bit():
    start, speeds = draw(2, knots=4)
    first = readings(run(RigidBodyPlant(ROBOT, start), speeds, step=0.01))
    second = readings(run(RigidBodyPlant(ROBOT, start), speeds, step=0.01))
    np.testing.assert_array_equal(first, second)


def test_reading_quantities_does_not_change_the_run():
    start, speeds = draw(2, knots=2)
    read_often = RigidBodyPlant(ROBOT, start)
    for there in speeds:
        read_often.advance(there, 0.5)
        readings(read_often), read_often.momentum, read_often.slip
    np.testing.assert_array_equal(
        readings(read_often), readings(run(RigidBodyPlant(ROBOT, start), speeds))
    )


def test_reset_plant_moves_as_a_new_one():
    start, speeds = draw(4, knots=2)
    plant = run(RigidBodyPlant(ROBOT, start), speeds)
    fresh = readings(plant)
    plant.push([1.0, 0.0])
    plant.advance(REST, 0.1)
    plant.reset(start)
    np.testing.assert_array_equal(plant.state, start)
    assert not np.any(readings(plant)[6:])
    np.testing.assert_array_equal(readings(run(plant, speeds)), fresh)


def test_displaced_sphere_keeps_its_rotors_and_its_momentum():
    start, speeds = draw(6, knots=2)
    elsewhere, _ = draw(7)
    ideal = run(RollingPlant(ROBOT, start), speeds)
    plant = run(RigidBodyPlant(ROBOT, start, IDEAL_DRIVES), speeds)
    before = plant.rotor_speeds
    for either in (ideal, plant):
        either.displace(elsewhere)
    np.testing.assert_array_equal(plant.state, elsewhere)
    np.testing.assert_array_equal(plant.rotor_speeds, before)
    np.testing.assert_allclose(plant.body_rate, ideal.body_rate, atol=1e-2)
    np.testing.assert_allclose(plant.momentum, 0.0, atol=1e-5)


def test_push_first_slips_then_rolls_on():
    plant = RigidBodyPlant(ROBOT, ORIGIN)
    plant.push([1.0, 0.0])
    assert plant.velocity[0] == pytest.approx(1.0 / ROBOT.total_mass)
    plant.advance(REST, 1.0)
    # Angular momentum about the contact point: Rs J = (It1 + m) v / Rs, rotors held.
    inertia = ROBOT.transverse_inertia + ROBOT.rolling_inertia
    assert plant.velocity[0] == pytest.approx(0.3**2 / inertia, rel=1e-3)
    np.testing.assert_allclose(plant.slip, 0.0, atol=1e-5)
    np.testing.assert_allclose(plant.momentum, [0.0, 0.3, 0.0], atol=1e-5)


def test_slope_rolls_the_sphere_downhill():
    slope = DisturbanceSettings(slope=np.radians(1.0), slope_direction=0.5 * np.pi)
    plant = RigidBodyPlant(ROBOT, ORIGIN, disturbances=slope)
    plant.advance(REST, 1.0)
    inertia = ROBOT.transverse_inertia + ROBOT.rolling_inertia
    acceleration = ROBOT.rolling_inertia * 9.81 * np.sin(slope.slope) / inertia
    np.testing.assert_allclose(plant.velocity[:2], [0.0, acceleration], atol=1e-3)


def test_slippery_floor_lets_the_shell_slip():
    plant = RigidBodyPlant(ROBOT, ORIGIN, replace(IDEAL_DRIVES, friction=0.05))
    plant.advance(np.array([0.0, 100.0]), 0.5)
    assert np.linalg.norm(plant.slip) > 0.1


def test_rolling_friction_brings_the_sphere_to_rest():
    plant = RigidBodyPlant(ROBOT, ORIGIN, None, DisturbanceSettings(rolling_friction=5e-3))
    plant.push([0.5, 0.0])
    plant.advance(REST, 2.0)
    assert np.linalg.norm(plant.velocity) < 1e-3


def test_spin_friction_takes_momentum_about_the_vertical():
    start, speeds = draw(8, knots=2)
    friction = DisturbanceSettings(torsional_friction=5e-3)
    plant = run(RigidBodyPlant(ROBOT, start, None, friction), speeds)
    assert abs(plant.momentum[2]) > 1e-3


def test_rough_floor_is_the_same_for_the_same_seed_only():
    def end(seed):
        settings = RigidBodySettings(floor_roughness=1e-3, floor_seed=seed, floor_extent=2.0)
        plant = RigidBodyPlant(ROBOT, ORIGIN, settings)
        plant.advance(REST, 0.2)
        assert 0.3 < plant.height < 0.32, "it should rest on the bumps"
        assert np.linalg.norm(plant.velocity) < 0.1, "it should touch the floor at the start"
        return plant.state

    np.testing.assert_array_equal(end(0), end(0))
    assert np.any(end(0) != end(1))


def test_unbalanced_robot_falls_over():
    robot = replace(ROBOT, counterweight_mass=0.6)
    plant = RigidBodyPlant(robot, ORIGIN, RigidBodySettings(balanced=False))
    trimmed = RigidBodyPlant(robot, ORIGIN)
    for either in (plant, trimmed):
        either.advance(REST, 1.0)
    assert angle_error(plant.state, ORIGIN) > 0.1
    assert angle_error(trimmed.state, ORIGIN) < 1e-6


def test_shell_too_light_to_balance_the_robot_is_refused():
    with pytest.raises(InvalidParameterError, match="shell_inertia"):
        RigidBodyPlant(RobotParameters(shell_mass=0.01, rotor_mass=2.0), ORIGIN)


def test_diverged_state_is_an_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into a file there
    plant = RigidBodyPlant(ROBOT, ORIGIN)
    plant.push([1e200, 0.0])
    with pytest.raises(PlantDivergedError):
        plant.advance(REST, 0.1)


def test_contact_stiffer_than_the_time_step_allows_is_refused():
    with pytest.raises(InvalidParameterError, match="contact_time_constant"):
        RigidBodySettings(contact_time_constant=0.003, time_step=0.002)
