# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Angular momentum of both plants: pushes, slopes, offsets of the centre of mass, friction."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sphere_nmpc.model.disturbance import momentum_of_push
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import matrix, random_quaternion
from sphere_nmpc.model.state import MOMENTUM, Vector, angle_error, make_state, position_error
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.study.motion import disturbance_of
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

pytest.importorskip("mujoco")

ROBOT = RobotParameters()
UPRIGHT = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
REST = np.zeros(2)
PUSH = np.array([0.6, -0.8])
SLOPE = DisturbanceSettings(slope=np.radians(1.0), slope_direction=2.0)
OFFSET = DisturbanceSettings(mass_offset_x=2e-3, mass_offset_y=-1e-3, mass_offset_z=2e-3)
ALL = replace(
    OFFSET, slope=0.02, slope_direction=-1.0, rolling_friction=5e-4, torsional_friction=5e-4
)
"""All at once."""


def drawn(seed: int, knots: int = 6) -> tuple[Vector, Vector]:
    """Return a random start, shape (6,), and rotor speeds each half second, shape (knots, 2)."""
    rng = np.random.default_rng(seed)
    start = make_state(np.zeros(2), random_quaternion(rng))
    return start, rng.uniform(-60.0, 60.0, (knots, 2))


def run(plant: Any, speeds: Vector) -> Any:
    for there in speeds:
        plant.advance(there, 0.5)
    return plant


def momentum_of(plant: RollingPlant, offset: Vector) -> Vector:
    """Return the momentum about the contact point of the moving bodies [N m s; world]."""
    turn = matrix(plant.state[2:])
    inertia = np.diag([ROBOT.transverse_inertia] * 2 + [ROBOT.axial_inertia])
    rate, c = turn @ plant.body_rate, turn @ offset
    spin = turn @ (
        inertia @ plant.body_rate + ROBOT.rotor_axial_inertia * np.append(plant.rotor_speeds, 0.0)
    )
    arm, mass = np.array([0.0, 0.0, ROBOT.shell_radius]), ROBOT.total_mass
    linear = mass * (plant.velocity + np.cross(rate, c))
    found: Vector = spin + mass * np.cross(c, plant.velocity) + np.cross(arm, linear)
    return found


def kinetic_energy(plant: RollingPlant) -> float:
    rate, spin = plant.body_rate, plant.rotor_speeds
    inertia = np.array([ROBOT.transverse_inertia] * 2 + [ROBOT.axial_inertia])
    moving = ROBOT.total_mass * plant.velocity @ plant.velocity
    coupled = ROBOT.rotor_axial_inertia * (spin @ spin + 2.0 * spin @ rate[:2])
    return 0.5 * float(moving + inertia @ rate**2 + coupled)


@pytest.mark.parametrize("settings", [DisturbanceSettings(), OFFSET, ALL])
def test_momentum_is_that_of_the_moving_bodies(settings: DisturbanceSettings) -> None:
    start, speeds = drawn(1)
    plant = RollingPlant(ROBOT, start, settings)
    plant.push(PUSH)
    offset = np.array(settings.mass_offset)
    for there in speeds:
        plant.advance(there, 0.5)
        # Rounding beside bodies that carry up to 1 N m s.
        np.testing.assert_allclose(momentum_of(plant, offset), plant.momentum, atol=1e-14)
    if settings == DisturbanceSettings():
        np.testing.assert_allclose(plant.momentum, [0.3 * 0.8, 0.3 * 0.6, 0.0], rtol=1e-15)
    before = plant.momentum
    plant.displace(UPRIGHT)
    np.testing.assert_array_equal(plant.momentum, before)
    plant.reset(UPRIGHT)
    assert not np.any(plant.momentum)


@pytest.mark.parametrize("settings", [DisturbanceSettings(), SLOPE, OFFSET])
def test_agrees_with_the_model(settings: DisturbanceSettings) -> None:
    start, speeds = drawn(3)
    plant = RollingPlant(ROBOT, start, settings)
    plant.push(PUSH)
    run(plant, speeds)
    state = roll_out(
        np.concatenate((start, momentum_of_push(ROBOT, PUSH))), np.vstack((REST, speeds)),
        np.full(len(speeds), 0.5), ROBOT.lumped.as_array(), 5e-3, disturbance_of(settings, ROBOT),
    )[-1]
    # Of a slope the model leaves out the cosine, 1 - 1.5e-4; all else is exact.
    exact = not settings.slope
    assert position_error(plant.state, state) < (1e-6 if exact else 1e-3)
    assert angle_error(plant.state, state) < (1e-6 if exact else 2e-3)
    jump = plant.momentum / ROBOT.rotor_axial_inertia - state[MOMENTUM]
    assert np.max(np.abs(jump)) < (1e-5 if exact else 1e-2)


def test_torque_agrees_with_the_acceleration_seen_from_outside() -> None:
    start, speeds = drawn(4, knots=3)
    plant = RollingPlant(ROBOT, start, ALL)
    plant.push(PUSH)
    run(plant, speeds)
    slope, h = np.array([300.0, -150.0]), 1e-6
    plant.advance(plant.rotor_speeds + slope * 0.1, 0.1)
    torque, before = plant.rotor_torques, plant.body_rate
    plant.advance(plant.rotor_speeds + slope * h, h)
    expected = ROBOT.rotor_axial_inertia * ((plant.body_rate - before)[:2] / h + slope)
    np.testing.assert_allclose(torque, expected, atol=1e-5)  # first order in h


@pytest.mark.parametrize(("kind", "tolerance"), [(RollingPlant, 1e-14), (RigidBodyPlant, 2e-4)])
def test_tilted_floor_gives_momentum_until_it_is_level_again(kind, tolerance) -> None:
    # With contact a little less in the first moment, while it has no load yet.
    plant = kind(ROBOT, UPRIGHT)
    plant.tilt(0.01, 0.5 * np.pi)
    plant.advance(REST, 0.5)
    gained = 0.5 * 9.81 * np.sin(0.01) * ROBOT.total_mass * ROBOT.shell_radius
    np.testing.assert_allclose(plant.momentum, [-gained, 0.0, 0.0], atol=tolerance)
    plant.tilt(0.0, 0.0)
    plant.advance(REST, 0.5)
    np.testing.assert_allclose(plant.momentum, [-gained, 0.0, 0.0], atol=tolerance)


def test_friction_only_takes_energy_and_brings_the_sphere_to_rest() -> None:
    friction = DisturbanceSettings(rolling_friction=2e-3, torsional_friction=1e-3)
    plant = RollingPlant(ROBOT, drawn(6)[0], friction)
    plant.push(PUSH)
    plant._y = (*plant._y[:8], 0.05)
    energies = []
    for _ in range(500):
        plant.advance(REST, 0.01)
        energies.append(kinetic_energy(plant))
    assert np.all(np.diff(energies) <= 1e-15) and energies[0] > 0.02
    # Coulomb: the horizontal momentum of 0.3 N m s is gone after 0.3 / (2 mm Mt g) = 4 s.
    assert energies[200] > 1e-3 and energies[-1] < 1e-12


# Rolling and torsional friction apart: MuJoCo lets them share one elliptic friction cone.
@pytest.mark.parametrize(
    "settings",
    [
        replace(OFFSET, slope=0.02, slope_direction=-1.0),
        DisturbanceSettings(rolling_friction=5e-4),
        DisturbanceSettings(torsional_friction=5e-4),
    ],
)
def test_agrees_with_the_plant_with_contact(settings: DisturbanceSettings) -> None:
    stiff = RigidBodySettings(
        drive_bandwidth=1e6, drive_feedforward=True, torque_limit=1e3, friction=2.0,
        time_step=5e-4, contact_time_constant=1e-3,
    )
    start, speeds = drawn(10)
    ideal = RollingPlant(ROBOT, start, settings)
    contact = RigidBodyPlant(ROBOT, start, stiff, settings)
    for plant in (ideal, contact):
        run(plant, speeds[:2])
        plant.push(PUSH)
        run(plant, speeds[2:])
    # Both deviate without disturbances by up to 0.3 mm and 2 mrad: the contact has to give way.
    assert position_error(contact.state, ideal.state) < 1e-3
    assert angle_error(contact.state, ideal.state) < 1e-2
    np.testing.assert_allclose(contact.momentum, ideal.momentum, atol=5e-4)
