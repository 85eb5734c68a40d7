# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulated IMU: what plants measure, its errors and its times."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import matrix, random_quaternion
from sphere_nmpc.model.state import Vector, make_state
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.imu_sensor import ImuReading, ImuSensor, SimulatedImuSettings
from sphere_sim.world.plant.contract import Plant
from sphere_sim.world.plant.rigid_body import rigid_body_plant
from sphere_sim.world.plant.rigid_body.mjcf import IMU
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.plant.rolling_plant import RollingPlant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

pytest.importorskip("mujoco")

ROBOT = RobotParameters()
TURNED = make_state((1.0, -2.0), (0.4, -0.3, 0.7, 0.5))
LEVEL = DisturbanceSettings()
SLOPE = DisturbanceSettings(slope=0.05, slope_direction=2.0)
UNEVEN = DisturbanceSettings(slope=0.02, slope_direction=-1.0, mass_offset_x=2e-3)
STIFF = RigidBodySettings(
    drive_bandwidth=1e6, drive_feedforward=True, torque_limit=1e3, friction=2.0, time_step=5e-4,
    contact_time_constant=1e-3,
)
AT = np.array([0.1, -0.2, 0.05])
MOUNTING = random_quaternion(np.random.default_rng(8))
TURN = matrix(MOUNTING)
EXACT = SimulatedImuSettings(
    position=tuple(AT), orientation=tuple(MOUNTING.tolist()), position_deviation=0.0,
    orientation_deviation=0.0, gyro_noise=0.0, gyro_bias=0.0, gyro_bias_walk=0.0, gyro_scale=0.0,
    g_sensitivity=0.0, cross_axis=0.0, accelerometer_noise=0.0, accelerometer_bias=0.0,
    accelerometer_bias_walk=0.0, accelerometer_scale=0.0,
)
MS, SECOND = 1_000_000, 1_000_000_000


def moved(plant: Plant, sensor: ImuSensor) -> Vector:
    """Return the readings of a sensor, shape (60, 6), over a motion of the rotors."""
    rng, before = np.random.default_rng(5), np.zeros(2)
    sensor.sample(0, plant)
    for k in range(60):
        if k % 20 == 0:
            slope = rng.uniform(-3.0, 3.0, 2)
        for _ in range(5):
            before = before + slope / 5.0
            plant.advance(before, 2e-3)
        sensor.sample(0, plant)
    return values(sensor.delivered(0))[1:]


def test_readings_are_those_of_the_sensors_of_the_engine(monkeypatch) -> None:
    """The engine's sensors are at a site with the mounting; means are over the period."""
    mjcf, read = rigid_body_plant.make_mjcf, []

    def with_sensors(*arguments) -> str:
        root = ElementTree.fromstring(mjcf(*arguments, imu=EXACT))
        sensors = ElementTree.SubElement(root, "sensor")
        for kind in ("gyro", "accelerometer"):
            ElementTree.SubElement(sensors, kind, site=IMU)
        return ElementTree.tostring(root, encoding="unicode")

    monkeypatch.setattr(rigid_body_plant, "make_mjcf", with_sensors)
    plant = RigidBodyPlant(ROBOT, TURNED, RigidBodySettings(), LEVEL)
    advance = plant.advance

    def recorded(speeds: Vector, duration: float) -> None:
        advance(speeds, duration)
        read.append(plant._data.sensordata.copy())  # of the start of the step

    monkeypatch.setattr(plant, "advance", recorded)
    found = moved(plant, ImuSensor(EXACT, 0))
    advance(plant.rotor_speeds, 2e-3)
    steps = np.array([*read, plant._data.sensordata])
    means = np.array([
        (0.5 * (steps[k] + steps[k + 5]) + steps[k + 1 : k + 5].sum(axis=0)) / 5.0
        for k in range(0, 300, 5)
    ])
    # The rate is that of the rotation. The trapezoidal rule of the engine's values is off by the
    # bend of the rate within a step of 2 ms; 2e-4 was seen.
    np.testing.assert_allclose(found[:, :3], means[:, :3], atol=1e-3)
    # The contact settles in the first one. Where the slope of the speeds changes, the trapezoidal
    # rule of the engine's values is off by a step's part: 0.027 was seen there, 0.003 elsewhere.
    np.testing.assert_allclose(found[1:, 3:], means[1:, 3:], atol=0.04)


def test_a_push_is_an_impulse_of_the_force() -> None:
    plant, sensor = RollingPlant(ROBOT, TURNED), ImuSensor(EXACT, 0)
    sensor.sample(0, plant)
    plant.push([0.5, -0.2])
    gained = plant.velocity + matrix(TURNED[2:]) @ np.cross(plant.body_rate, AT)
    sensor.sample(0, plant)
    before, pushed = values(sensor.delivered(0))[:, 3:]
    np.testing.assert_allclose(0.01 * (pushed - before), TURN.T @ matrix(TURNED[2:]).T @ gained)


def test_readings_of_both_plants_agree() -> None:
    rolling = RollingPlant(ROBOT, TURNED, UNEVEN)
    rigid = RigidBodyPlant(ROBOT, TURNED, STIFF, UNEVEN)
    found = [moved(plant, ImuSensor(EXACT, 0)) for plant in (rolling, rigid)]
    # The poses differ by up to 2 mrad, as in the test that they agree; gravity by as much.
    np.testing.assert_allclose(*found, atol=2e-3 * GRAVITY)


@pytest.mark.parametrize("kind", [RollingPlant, RigidBodyPlant])
def test_at_rest_the_force_is_opposite_to_gravity(kind) -> None:
    plant = kind(ROBOT, TURNED, disturbances=SLOPE)
    (found,) = ImuSensor(EXACT, 0).at_rest(0.01, plant)
    np.testing.assert_allclose(found.force, -matrix(TURNED[2:]).T @ SLOPE.gravity @ TURN)
    np.testing.assert_array_equal(found.rate, 0.0)


def readings(imu: SimulatedImuSettings, seed: int = 3, until: float = 1.0) -> list[ImuReading]:
    """Return what the IMU of a sphere at rest measures."""
    simulator = Simulator(SimulatorSettings(seed=seed), ROBOT, imu=imu)
    simulator.advance_to(round(until * SECOND))
    return simulator.imu_readings()


def values(found: list[ImuReading]) -> Vector:
    return np.array([(*reading.rate, *reading.force) for reading in found])


def test_readings_are_what_the_plant_measures_at_their_stamps_and_come_late() -> None:
    simulator = Simulator(SimulatorSettings(), ROBOT, imu=replace(EXACT, rate=40.0, latency=0.01))
    hold = FirstOrderHold(np.array([0.0, 0.3, 1.0]), np.array([[0, 0], [90, -70], [0, 0.0]]))
    simulator.follower.follow_trajectory(hold)
    before = np.zeros(3)
    for i in range(8):
        simulator.advance_to(25 * MS * i)
        plant = simulator.plant
        mean, before = 0.5 * (before + plant.body_rate) @ TURN, plant.body_rate
        true = plant.rotor_angles, plant.rotor_speeds
        torques = plant.rotor_torques
        simulator.advance_to(simulator.now + 10 * MS - 1)
        assert simulator.imu_readings() == []
        simulator.advance_to(simulator.now + 1)
        (found,) = simulator.imu_readings()
        assert found.stamp == 25 * MS * i and simulator.imu_readings() == []
        # The mean since the reading before, in which the rate is nearly linear.
        np.testing.assert_allclose(found.rate, mean, rtol=0.0, atol=2e-3)
        np.testing.assert_array_equal((found.angles, found.speeds), true)
        np.testing.assert_array_equal(found.torques, torques)


def test_errors_are_those_of_the_settings_and_of_the_seed_alone() -> None:
    plant = RollingPlant(ROBOT, TURNED)
    plant.push([1.0, 0.0])
    perfect = ImuSensor(EXACT, 0)
    perfect.sample(0, plant)
    true = values(perfect.delivered(0))[0]

    def of_seeds(**changes: float) -> Vector:
        sensors = [ImuSensor(replace(EXACT, **changes), seed) for seed in range(200)]
        for sensor in sensors:
            sensor.sample(0, plant)
        return values([reading for sensor in sensors for reading in sensor.delivered(0)])

    # 600 draws: the deviation of a deviation is 1 / sqrt(1200) = 3 %; four of these.
    bias = of_seeds(gyro_bias=0.02, accelerometer_bias=0.3) - true
    np.testing.assert_allclose([bias[:, :3].std(), bias[:, 3:].std()], [0.02, 0.3], rtol=0.12)
    scale = of_seeds(gyro_scale=0.05) / true
    np.testing.assert_allclose(scale[:, :3].std(), 0.05, rtol=0.12)
    np.testing.assert_allclose(scale[:, 3:], 1.0, rtol=1e-14)
    rate, force = true[:3], true[3:]
    crossing = (of_seeds(cross_axis=0.02) - true)[:, :3]
    # Of two other axes for each.
    np.testing.assert_allclose(
        crossing.std(), 0.02 * np.sqrt(2.0 / 3.0 * float(rate @ rate)), rtol=0.12
    )
    felt = (of_seeds(g_sensitivity=0.01) - true)[:, :3]
    np.testing.assert_allclose(felt.std(), 0.01 * np.linalg.norm(force), rtol=0.12)
    noisy = replace(EXACT, gyro_noise=1e-3, accelerometer_noise=2e-2, gyro_bias_walk=1e-2)
    found = readings(noisy, until=20.0)
    steps = np.diff(values(found), axis=0)
    # White noise differs from one reading to the next by twice its variance, and by the walk's.
    expected = np.sqrt(2.0 * noisy.deviations**2 + [1e-2**2 / 100.0, 0.0])
    np.testing.assert_allclose(noisy.deviations, [1e-2, 0.2])
    np.testing.assert_allclose([steps[:, :3].std(), steps[:, 3:].std()], expected, rtol=0.06)
    moved = values(readings(replace(EXACT, gyro_bias_walk=1e-2), until=20.0))[:, :3]
    np.testing.assert_allclose(np.diff(moved, axis=0).std(), 1e-2 * 0.1, rtol=0.06)
    often = Simulator(SimulatorSettings(seed=3), ROBOT, imu=noisy)
    read = []
    for i in range(100):
        often.advance_to(7 * MS * (i + 1))
        read += often.imu_readings()
    np.testing.assert_array_equal(values(read), values(found)[: len(read)])
    assert not np.any(values(readings(noisy, seed=4)) == values(found)[:101])


def test_readings_at_rest_have_the_same_bias_and_end_in_the_first_one() -> None:
    imu = SimulatedImuSettings(
        gyro_noise=0.0, accelerometer_noise=0.0, gyro_bias_walk=1e-3, accelerometer_bias_walk=0.0
    )
    simulator = Simulator(SimulatorSettings(), ROBOT, imu=imu)
    (first,) = simulator.imu_readings()
    long, short = (simulator.imu.at_rest(length, simulator.plant) for length in (2.0, 0.5))
    assert [reading.stamp for reading in short] == [10 * MS * i for i in range(-50, 0)]
    np.testing.assert_array_equal(values(long)[-50:], values(short))
    force = np.tile(first.force, (200, 1))
    np.testing.assert_allclose(values(long)[:, 3:], force, rtol=1e-14)
    walk = np.diff(values([*long, first])[:, :3], axis=0)
    # 600 draws, as above.
    np.testing.assert_allclose(walk.std(), 1e-3 * 0.1, rtol=0.12)


def test_beyond_its_range_a_sensor_is_saturated() -> None:
    read = []
    for ranges in ({}, {"gyro_range": 0.5, "accelerometer_range": 5.0}):
        simulator = Simulator(SimulatorSettings(), ROBOT, imu=replace(EXACT, **ranges))
        simulator.plant.push([3.0, 0.0])
        simulator.advance_to(SECOND)
        read.append(values(simulator.imu_readings())[-1])
    true, found = read
    limits = np.repeat([0.5, 5.0], 3)
    beyond = np.abs(true) > limits
    assert beyond[:3].any() and beyond[3:].any()
    np.testing.assert_array_equal(found[beyond], (np.sign(true) * limits)[beyond])
    assert np.all(np.abs(found) <= limits)


def test_imu_that_nobody_wants_is_never_read_and_changes_no_step(monkeypatch) -> None:
    hold = FirstOrderHold(np.array([0.0, 0.3, 1.0]), np.array([[0, 0], [90, -70], [0, 0.0]]))
    ends = []
    for imu in (None, replace(EXACT, rate=333.0)):
        simulator = Simulator(SimulatorSettings(position_noise=0.01), ROBOT, imu=imu)
        assert len(simulator.imu_readings()) == (imu is not None)
        simulator.fit_imu(None)
        monkeypatch.setattr(ImuSensor, "sample", None)
        simulator.follower.follow_trajectory(hold)
        simulator.advance_to(SECOND)
        ends.append((*simulator.plant.state, *simulator.measured_state()))
        assert simulator.imu_readings() == []
        monkeypatch.undo()
    np.testing.assert_array_equal(*ends)
