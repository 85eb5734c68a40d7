# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The plant with contact: agreement with the ideal one, contact, drives and floors."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from printed_model import PrintedModel

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import angle_error, position_error
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.plant.rigid_body.rigid_body_plant import PlantDivergedError, RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

pytest.importorskip("mujoco")

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


def run(plant, speeds):
    for there in speeds:
        plant.advance(there, 0.5)
    return plant


def readings(plant):
    return np.concatenate((
        plant.state, plant.body_rate, plant.velocity, plant.rotor_angles, plant.rotor_speeds,
        plant.rotor_torques,
    ))


def perturbed(seed):
    """Return a robot of which each mass and inertia is off by up to 20 %."""
    rng = np.random.default_rng(seed)
    names = [name for name in ROBOT.__dataclass_fields__ if name.endswith(("mass", "inertia"))]
    return replace(ROBOT, **{name: getattr(ROBOT, name) * rng.uniform(0.8, 1.2) for name in names})


@pytest.mark.parametrize("robot", [ROBOT, perturbed(3)])
def test_follows_the_rolling_plant_with_ideal_drives(robot):
    start, speeds = draw(robot.shell_mass != 1.0)
    ideal = run(RollingPlant(robot, start), speeds)
    plant = run(RigidBodyPlant(robot, start, IDEAL_DRIVES), speeds)
    assert position_error(plant.state, ideal.state) < POSITION_TOLERANCE
    assert angle_error(plant.state, ideal.state) < ANGLE_TOLERANCE
    np.testing.assert_allclose(plant.body_rate, ideal.body_rate, atol=0.02)
    np.testing.assert_allclose(plant.velocity, ideal.velocity, atol=5e-3)
    np.testing.assert_allclose(plant.rotor_speeds, speeds[-1], atol=0.1)
    np.testing.assert_allclose(plant.rotor_angles, ideal.rotor_angles, atol=0.1)
    # Reading quantities has not changed the run, and a reset plant moves as a new one.
    before = readings(plant)
    plant.push([1.0, 0.0])
    plant.advance(REST, 0.1)
    plant.reset(start)
    np.testing.assert_array_equal(plant.state, start)
    assert not np.any(readings(plant)[6:])
    for there in speeds:
        plant.advance(there, 0.5)
        readings(plant), plant.momentum, plant.slip
    np.testing.assert_array_equal(readings(plant), before)


@pytest.mark.parametrize("seed", range(2))
def test_one_sign_separates_the_printed_eq_12_from_the_motion(seed):
    start, speeds = draw(seed, knots=4)
    contact = run(RigidBodyPlant(ROBOT, start, IDEAL_DRIVES), speeds).state
    corrected, printed = (
        run(PrintedModel(ROBOT, start, corrected=corrected), speeds).state
        for corrected in (True, False)
    )
    rolling = run(RollingPlant(ROBOT, start), speeds).state
    np.testing.assert_allclose(corrected, rolling, atol=1e-5)
    assert angle_error(corrected, contact) < 5e-3 and position_error(corrected, contact) < 1e-3
    assert angle_error(printed, contact) > 0.1 and position_error(printed, contact) > 0.02


def test_momentum_about_the_contact_point_stays_zero_and_is_kept_where_it_is_displaced():
    (start, speeds), (elsewhere, _) = draw(11), draw(7)
    plant = RigidBodyPlant(ROBOT, start)
    scale = ROBOT.rotor_axial_inertia * 100.0
    for there in speeds:
        plant.advance(there, 0.5)
        np.testing.assert_allclose(plant.momentum, 0.0, atol=1e-5 * scale)
    before = plant.rotor_speeds
    plant.displace(elsewhere)
    np.testing.assert_array_equal(plant.state, elsewhere)
    np.testing.assert_array_equal(plant.rotor_speeds, before)
    np.testing.assert_allclose(plant.momentum, 0.0, atol=1e-5)


def test_torque_stays_within_its_limit_and_the_rotor_lags_behind():
    plant = RigidBodyPlant(ROBOT, ORIGIN, RigidBodySettings(torque_limit=0.8))
    for i in range(10):
        plant.advance(np.array([10.0 * (i + 1), 0.0]), 0.025)
        assert np.all(np.abs(plant.rotor_torques) <= 0.8)
    # A fixed shell would allow 0.8 / I1 = 100 rad/s^2; it gives way by 2 %.
    np.testing.assert_allclose(plant.rotor_speeds, [0.25 * 101.8, 0.0], atol=0.5)
    slow = RigidBodyPlant(ROBOT, ORIGIN, RigidBodySettings(drive_bandwidth=50.0))
    slow.advance(np.array([50.0, 0.0]), 0.5)
    assert slow.rotor_speeds[0] == pytest.approx(50.0 - 100.0 / 50.0, abs=0.1)


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
    slippery = RigidBodyPlant(ROBOT, ORIGIN, replace(IDEAL_DRIVES, friction=0.05))
    slippery.advance(np.array([0.0, 100.0]), 0.5)
    assert np.linalg.norm(slippery.slip) > 0.1


def test_rough_floor_is_the_same_for_the_same_seed_only():
    def end(seed):
        settings = RigidBodySettings(floor_roughness=1e-3, floor_seed=seed, floor_extent=2.0)
        plant = RigidBodyPlant(ROBOT, ORIGIN, settings)
        plant.advance(REST, 0.2)
        assert 0.3 < plant._data.qpos[2] < 0.32, "it should rest on the bumps"
        assert np.linalg.norm(plant.velocity) < 0.1, "it should touch the floor at the start"
        return plant.state

    np.testing.assert_array_equal(end(0), end(0))
    assert np.any(end(0) != end(1))


def test_unbalanced_robot_falls_over_and_one_that_cannot_be_balanced_is_refused():
    robot = replace(ROBOT, counterweight_mass=0.6)
    plant = RigidBodyPlant(robot, ORIGIN, RigidBodySettings(balanced=False))
    trimmed = RigidBodyPlant(robot, ORIGIN)
    for either in (plant, trimmed):
        either.advance(REST, 1.0)
    assert angle_error(plant.state, ORIGIN) > 0.1
    assert angle_error(trimmed.state, ORIGIN) < 1e-6
    with pytest.raises(InvalidParameterError, match="shell_inertia"):
        RigidBodyPlant(RobotParameters(shell_mass=0.01, rotor_mass=2.0), ORIGIN)


def test_diverged_state_is_an_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into a file there
    plant = RigidBodyPlant(ROBOT, ORIGIN)
    plant.push([1e200, 0.0])
    with pytest.raises(PlantDivergedError):
        plant.advance(REST, 0.1)


def test_missing_mujoco_is_named_with_its_extra_and_not_loaded_where_it_is_not_needed(monkeypatch):
    code = "import sys, sphere_sim.world.simulator; sys.exit('mujoco' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert isinstance(make_plant("rolling", ROBOT, ORIGIN), RollingPlant)
    with pytest.raises(ImportError, match=r"sphere_nmpc\[rigid\]"):
        make_plant("rigid_body", ROBOT, ORIGIN)
    with pytest.raises(InvalidParameterError, match="rolling or rigid_body"):
        make_plant("flying", ROBOT, ORIGIN)
