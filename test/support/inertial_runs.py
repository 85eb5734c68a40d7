# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulated motions with the readings of an IMU in the shell, for tests of the odometry."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.estimation.odometry_settings import OdometrySettings
from sphere_nmpc.model.error_state import error_between
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.world.imu_sensor import ImuReading, SimulatedImuSettings
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
IMU = SimulatedImuSettings(position=(0.1, -0.05, 0.08), orientation=(0.5, 0.5, -0.5, 0.5))
SECOND = 1_000_000_000
Change = Callable[[ImuReading], ImuReading | None]


@dataclass(frozen=True, eq=False)
class Run:
    """Readings from 2.5 s of rest on, and the true poses at those from time 0 on."""

    readings: list[ImuReading]
    states: dict[int, Vector]


@lru_cache(maxsize=64)
def random_run(
    seed: int, duration: float, plant: str = "rolling", robot: RobotParameters = ROBOT,
    push: float = 0.0, friction: float = 0.8,
) -> Run:
    """Return a motion by random rotor speeds, with rest of 2 s at its end.

    A push of `push` [N s] is given after 3 s; `friction` is that of the plant ``rigid_body``.
    """
    rng = np.random.default_rng(seed)
    quaternion = rng.normal(size=4)
    start = (0.0, 0.0, *(quaternion / np.linalg.norm(quaternion)).tolist())
    settings = SimulatorSettings(plant=plant, initial_state=start, seed=seed)
    own = RigidBodySettings(friction=friction) if plant == "rigid_body" else None
    made = make_plant(plant, robot, np.array(start), own)
    simulator = Simulator(settings, robot, made, IMU)
    times = np.arange(0.0, duration, 0.5)
    speeds = rng.uniform(-100.0, 100.0, (times.size, 2))
    speeds[[0, -1]] = 0.0
    simulator.follower.follow_trajectory(FirstOrderHold(times, speeds))
    assert simulator.imu is not None
    readings = simulator.imu.at_rest(2.5, simulator.plant) + simulator.imu_readings()
    states = {0: simulator.plant.state}
    for k in range(1, round(100 * (duration + 2.0)) + 1):
        if push and k == 301:
            simulator.plant.push((push, 0.3 * push))
        simulator.advance_to(k * SECOND // 100)
        readings += simulator.imu_readings()
        states[simulator.now] = simulator.plant.state
    return Run(readings, states)


def followed(
    run: Run, settings: OdometrySettings | None = None, change: Change = lambda one: one,
    rotors: Change = lambda one: one, watch: Callable[[Odometry, int], None] | None = None,
    robot: RobotParameters = ROBOT,
) -> Odometry:
    """Return an odometry that has followed a run.

    By default it knows the start. `change` and `rotors` return what is received of a reading by
    the IMU's and the encoders' topics, None for nothing; `watch` is called at each true pose.
    """
    settings = settings or OdometrySettings(initial_state=tuple(run.states[0].tolist()))
    odometry = Odometry(settings, IMU, robot)
    for one in run.readings:
        inertial, of_rotors = change(one), rotors(one)
        if inertial is not None:
            odometry.observe_imu(inertial.stamp / SECOND, inertial.rate, inertial.force)
        if of_rotors is not None:
            odometry.observe_rotors(of_rotors.stamp / SECOND, of_rotors.speeds, of_rotors.angles)
        odometry.check(one.stamp / SECOND)
        if watch is not None and one.stamp in run.states:
            watch(odometry, one.stamp)
    return odometry


def error_of(odometry: Odometry, true: Vector) -> tuple[Vector, float]:
    """Return the error of the estimate, shape (5,), and its normalised square."""
    found = odometry.estimate
    assert found is not None
    error = error_between(found.pose, true)
    return error, float(error @ np.linalg.solve(found.covariance, error))
