# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Both plants: accuracy, invariants, agreement, disturbances, and what contact and drives add."""

import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from printed_model import PrintedModel
from scipy.integrate import solve_ivp
from sized_robots import ROBOTS

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.disturbance import momentum_of_push
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import matrix, random_quaternion
from sphere_nmpc.model.state import (
    MOMENTUM,
    Vector,
    angle_error,
    make_state,
    position_error,
    without_momentum,
)
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.study.motion import disturbance_of
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.plant.rigid_body.rigid_body_plant import PlantDivergedError, RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

pytest.importorskip("mujoco")

ROBOT = RobotParameters()
UPRIGHT = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
REST = np.zeros(2)
PUSH = np.array([0.6, -0.8])
NONE = DisturbanceSettings()
SLOPE = DisturbanceSettings(slope=np.radians(1.0), slope_direction=2.0)
OFFSET = DisturbanceSettings(mass_offset_x=2e-3, mass_offset_y=-1e-3, mass_offset_z=2e-3)
TILTED = replace(OFFSET, slope=0.02, slope_direction=-1.0)
ALL = replace(TILTED, rolling_friction=5e-4, torsional_friction=5e-4)
IDEAL_DRIVES = RigidBodySettings(
    drive_bandwidth=1e6, drive_feedforward=True, torque_limit=1e3, friction=2.0
)
STIFF = replace(IDEAL_DRIVES, time_step=5e-4, contact_time_constant=1e-3)
INERTIA = np.diag([ROBOT.transverse_inertia] * 2 + [ROBOT.axial_inertia])


def drawn(seed: int, knots: int = 6, limit: float = 60.0) -> tuple[Vector, Vector]:
    """Return a random start, shape (6,), and rotor speeds each half second, shape (knots, 2)."""
    rng = np.random.default_rng(seed)
    start = make_state(rng.uniform(-3.0, 3.0, 2), random_quaternion(rng))
    return start, rng.uniform(-limit, limit, (knots, 2))


def run(plant: Any, speeds: Vector) -> Any:
    for there in speeds:
        plant.advance(there, 0.5)
    return plant


def readings(plant: Any) -> Vector:
    return np.concatenate((
        plant.state, plant.body_rate, plant.velocity, plant.rotor_angles, plant.rotor_speeds,
        plant.rotor_torques,
    ))


@pytest.mark.parametrize("name", ROBOTS)
def test_agrees_with_an_adaptive_integrator(name) -> None:
    robot, (start, _) = ROBOTS[name], drawn(1)
    limit = robot.max_rotor_speed
    ramp = 2.0 * limit / robot.max_rotor_acceleration
    plant, y, before = RollingPlant(robot, start), without_momentum(start), REST
    for there in limit * np.random.default_rng(2).choice([-1.0, 1.0], (6, 2)):

        def rate(time: float, y: Vector, before=before, there=there) -> Vector:
            return np.array(plant.rate(tuple(y), *(before + time / ramp * (there - before))))

        y = solve_ivp(rate, (0.0, ramp), y, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        plant.advance(there, ramp)
        before = there
    np.testing.assert_allclose(plant.state[:2], y[:2], atol=1e-5 * robot.shell_radius)
    np.testing.assert_allclose(plant.state[2:], y[2:6], atol=1e-5)


def momentum_of(plant: RollingPlant, offset: Vector) -> Vector:
    """Return the momentum about the contact point of the moving bodies [N m s; world]."""
    turn = matrix(plant.state[2:])
    rate, c = turn @ plant.body_rate, turn @ offset
    spin = turn @ (
        INERTIA @ plant.body_rate + ROBOT.rotor_axial_inertia * np.append(plant.rotor_speeds, 0.0)
    )
    arm, mass = np.array([0.0, 0.0, ROBOT.shell_radius]), ROBOT.total_mass
    linear = mass * (plant.velocity + np.cross(rate, c))
    found: Vector = spin + mass * np.cross(c, plant.velocity) + np.cross(arm, linear)
    return found


@pytest.mark.parametrize("settings", [NONE, OFFSET, ALL])
def test_quantities_are_those_of_moving_bodies_that_roll(settings: DisturbanceSettings) -> None:
    start, speeds = drawn(2, 20, 100.0)
    plant = RollingPlant(ROBOT, start, settings)
    plant.push(PUSH)
    for there in speeds:
        plant.advance(there, 0.5)
        # Rounding beside bodies that carry up to 1 N m s.
        momentum = momentum_of(plant, np.array(settings.mass_offset))
        np.testing.assert_allclose(momentum, plant.momentum, atol=3e-14)
        rate = matrix(plant.state[2:]) @ plant.body_rate
        rolling = np.cross(rate, [0.0, 0.0, ROBOT.shell_radius])
        np.testing.assert_allclose(plant.velocity, rolling, atol=1e-14)
        assert abs(np.linalg.norm(plant.state[2:6]) - 1.0) < 4e-15
    if settings == NONE:
        np.testing.assert_allclose(plant.momentum, [0.3 * 0.8, 0.3 * 0.6, 0.0], rtol=1e-15)
    # Seen from outside, to first order in h; the torque is the limit of Eq. (46).
    slope, h = np.array([300.0, -150.0]), 1e-6
    plant.advance(plant.rotor_speeds + slope * 0.1, 0.1)
    torque, state, rate, velocity = (
        plant.rotor_torques, plant.state, plant.body_rate, plant.velocity
    )
    plant.advance(plant.rotor_speeds + slope * h, h)
    expected = ROBOT.rotor_axial_inertia * ((plant.body_rate - rate)[:2] / h + slope)
    np.testing.assert_allclose(torque, expected, atol=1e-5)
    np.testing.assert_allclose((plant.state - state)[:2] / h, velocity[:2], atol=1e-3)


def test_torque_from_rest_in_an_upright_sphere_agrees_with_hand_calculation() -> None:
    plant = RollingPlant(ROBOT, UPRIGHT)
    plant.advance(np.array([4e-6, 0.0]), 1e-8)  # 400 rad/s^2
    # The shell turns the other way by c1 = 0.008 / 0.4575 of it: 0.008 * 400 * (1 - c1) N m.
    expected = [3.2 * (1 - 0.008 / 0.4575), 0.0]
    np.testing.assert_allclose(plant.rotor_torques, expected, atol=1e-9)


@pytest.mark.parametrize("settings", [NONE, SLOPE, OFFSET])
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


@pytest.mark.parametrize("kind", [RollingPlant, RigidBodyPlant])
def test_displacing_keeps_the_motion_that_a_reset_ends(kind) -> None:
    plant, elsewhere = kind(ROBOT, UPRIGHT), drawn(7)[0]
    plant.push(PUSH)
    plant.advance(np.array([40.0, -10.0]), 0.5)
    plant.advance(np.array([0.0, 20.0]), 0.25)
    moving = plant.momentum, plant.rotor_speeds, plant.rotor_angles
    plant.displace(elsewhere)
    np.testing.assert_array_equal(plant.state, elsewhere)
    # MuJoCo has the momentum of all bodies, which are where rounding leaves them.
    for before, after in zip(
        moving, (plant.momentum, plant.rotor_speeds, plant.rotor_angles), strict=True
    ):
        np.testing.assert_allclose(after, before, atol=1e-5)
    if kind is RollingPlant:
        np.testing.assert_allclose(moving[2], [10.0 + 5.0, -2.5 + 1.25], atol=1e-12)
    plant.reset(UPRIGHT)
    np.testing.assert_array_equal(plant.state, UPRIGHT)
    assert not np.any(readings(plant)[6:]) and not np.any(plant.momentum)


# With contact a little less in the first moment, while it has no load yet.
@pytest.mark.parametrize(("kind", "tolerance"), [(RollingPlant, 1e-14), (RigidBodyPlant, 2e-4)])
def test_tilted_floor_gives_momentum_until_it_is_level_again(kind, tolerance) -> None:
    plant = kind(ROBOT, UPRIGHT)
    gained = 0.5 * 9.81 * np.sin(0.01) * ROBOT.total_mass * ROBOT.shell_radius
    for angle in (0.01, 0.0):
        plant.tilt(angle, 0.5 * np.pi)
        plant.advance(REST, 0.5)
        np.testing.assert_allclose(plant.momentum, [-gained, 0.0, 0.0], atol=tolerance)


def kinetic_energy(plant: RollingPlant) -> float:
    rate, spin = plant.body_rate, plant.rotor_speeds
    moving = ROBOT.total_mass * plant.velocity @ plant.velocity
    coupled = ROBOT.rotor_axial_inertia * (spin @ spin + 2.0 * spin @ rate[:2])
    return 0.5 * float(moving + rate @ INERTIA @ rate + coupled)


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


def perturbed(seed: int) -> RobotParameters:
    """Return a robot of which each mass and inertia is off by up to 20 %."""
    rng = np.random.default_rng(seed)
    names = [name for name in ROBOT.__dataclass_fields__ if name.endswith(("mass", "inertia"))]
    return replace(ROBOT, **{name: getattr(ROBOT, name) * rng.uniform(0.8, 1.2) for name in names})


@pytest.mark.parametrize(
    ("robot", "settings"),
    [
        (ROBOT, NONE), (perturbed(3), NONE), (ROBOT, TILTED),
        # Rolling and torsional friction apart: MuJoCo lets them share one elliptic friction cone.
        (ROBOT, DisturbanceSettings(rolling_friction=5e-4)),
        (ROBOT, DisturbanceSettings(torsional_friction=5e-4)),
    ],
)
def test_plants_agree(robot: RobotParameters, settings: DisturbanceSettings) -> None:
    start, speeds = drawn(10)
    ideal, contact = RollingPlant(robot, start, settings), RigidBodyPlant(
        robot, start, STIFF, settings
    )
    for plant in (ideal, contact):
        run(plant, speeds[:2])
        plant.push(PUSH)
        run(plant, speeds[2:])
    # Both deviate without disturbances by up to 0.3 mm and 2 mrad: the contact has to give way.
    assert position_error(contact.state, ideal.state) < 1e-3
    assert angle_error(contact.state, ideal.state) < 1e-2
    np.testing.assert_allclose(contact.momentum, ideal.momentum, atol=5e-4)
    np.testing.assert_allclose(contact.body_rate, ideal.body_rate, atol=0.02)
    np.testing.assert_allclose(contact.velocity, ideal.velocity, atol=5e-3)
    np.testing.assert_allclose(contact.rotor_speeds, ideal.rotor_speeds, atol=0.1)
    np.testing.assert_allclose(contact.rotor_angles, ideal.rotor_angles, atol=0.1)


def test_reset_plant_moves_as_a_new_one_and_is_not_changed_by_reading() -> None:
    start, speeds = drawn(11, 10, 100.0)
    plant = run(RigidBodyPlant(ROBOT, start), speeds)
    before = readings(plant)
    plant.reset(start)
    for there in speeds:
        plant.advance(there, 0.5)
        readings(plant), plant.slip
        # About the contact point; rotors at 100 rad/s have 0.8 N m s.
        np.testing.assert_allclose(plant.momentum, 0.0, atol=8e-6)
    np.testing.assert_array_equal(readings(plant), before)


@pytest.mark.parametrize("seed", range(2))
def test_one_sign_separates_the_printed_eq_12_from_the_motion(seed) -> None:
    start, speeds = drawn(seed, 4, 100.0)
    contact = run(RigidBodyPlant(ROBOT, start, IDEAL_DRIVES), speeds).state
    corrected, printed = (
        run(PrintedModel(ROBOT, start, corrected=corrected), speeds).state
        for corrected in (True, False)
    )
    rolling = run(RollingPlant(ROBOT, start), speeds).state
    np.testing.assert_allclose(corrected, rolling, atol=1e-5)
    assert angle_error(corrected, contact) < 5e-3 and position_error(corrected, contact) < 1e-3
    assert angle_error(printed, contact) > 0.1 and position_error(printed, contact) > 0.02


def test_torque_stays_within_its_limit_and_the_rotor_lags_behind() -> None:
    plant = RigidBodyPlant(ROBOT, UPRIGHT, RigidBodySettings(torque_limit=0.8))
    for i in range(10):
        plant.advance(np.array([10.0 * (i + 1), 0.0]), 0.025)
        assert np.all(np.abs(plant.rotor_torques) <= 0.8)
    # A fixed shell would allow 0.8 / I1 = 100 rad/s^2; it gives way by 2 %.
    np.testing.assert_allclose(plant.rotor_speeds, [0.25 * 101.8, 0.0], atol=0.5)
    slow = RigidBodyPlant(ROBOT, UPRIGHT, RigidBodySettings(drive_bandwidth=50.0))
    slow.advance(np.array([50.0, 0.0]), 0.5)
    assert slow.rotor_speeds[0] == pytest.approx(50.0 - 100.0 / 50.0, abs=0.1)


def test_push_first_slips_then_rolls_on() -> None:
    plant = RigidBodyPlant(ROBOT, UPRIGHT)
    plant.push([1.0, 0.0])
    assert plant.velocity[0] == pytest.approx(1.0 / ROBOT.total_mass)
    plant.advance(REST, 1.0)
    # Angular momentum about the contact point: Rs J = (It1 + m) v / Rs, rotors held.
    inertia = ROBOT.transverse_inertia + ROBOT.rolling_inertia
    assert plant.velocity[0] == pytest.approx(0.3**2 / inertia, rel=1e-3)
    np.testing.assert_allclose(plant.slip, 0.0, atol=1e-5)
    np.testing.assert_allclose(plant.momentum, [0.0, 0.3, 0.0], atol=1e-5)
    slippery = RigidBodyPlant(ROBOT, UPRIGHT, replace(IDEAL_DRIVES, friction=0.05))
    slippery.advance(np.array([0.0, 100.0]), 0.5)
    assert np.linalg.norm(slippery.slip) > 0.1


def test_rough_floor_is_the_same_for_the_same_seed_only() -> None:
    def end(seed: int) -> Vector:
        settings = RigidBodySettings(floor_roughness=1e-3, floor_seed=seed, floor_extent=2.0)
        plant = RigidBodyPlant(ROBOT, UPRIGHT, settings)
        plant.advance(REST, 0.2)
        assert 0.3 < plant._data.qpos[2] < 0.32, "it should rest on the bumps"
        assert np.linalg.norm(plant.velocity) < 0.1, "it should touch the floor at the start"
        return plant.state

    np.testing.assert_array_equal(end(0), end(0))
    assert np.any(end(0) != end(1))


def test_unbalanced_robot_falls_over_and_one_that_cannot_be_balanced_is_refused() -> None:
    robot = replace(ROBOT, counterweight_mass=0.6)
    unbalanced, trimmed = RigidBodySettings(balanced=False), RigidBodySettings()
    ends = [
        run(RigidBodyPlant(robot, UPRIGHT, settings), [REST, REST]).state
        for settings in (unbalanced, trimmed)
    ]
    assert angle_error(ends[0], UPRIGHT) > 0.1 and angle_error(ends[1], UPRIGHT) < 1e-6
    with pytest.raises(InvalidParameterError, match="shell_inertia"):
        light = RobotParameters(shell_mass=0.01, rotor_mass=2.0, shell_inertia=6e-4)
        RigidBodyPlant(light, UPRIGHT)


def test_diverged_state_is_an_error(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into a file there
    plant = RigidBodyPlant(ROBOT, UPRIGHT)
    plant.push([1e200, 0.0])
    with pytest.raises(PlantDivergedError):
        plant.advance(REST, 0.1)


def test_missing_mujoco_is_named_with_its_extra_and_not_loaded_where_it_is_not_needed(
    monkeypatch,
) -> None:
    code = "import sys, sphere_sim.world.simulator; sys.exit('mujoco' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert isinstance(make_plant("rolling", ROBOT, UPRIGHT), RollingPlant)
    for name, error, words in (
        ("rigid_body", ImportError, r"sphere_nmpc\[rigid\]"),
        ("flying", InvalidParameterError, "rolling or rigid_body"),
    ):
        with pytest.raises(error, match=words):
            make_plant(name, ROBOT, UPRIGHT)
