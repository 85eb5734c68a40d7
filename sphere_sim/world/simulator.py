# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator: a plant with its drives, noise and sensors."""

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, QUATERNION, Vector, as_state
from sphere_nmpc.quantities import NANOSECONDS
from sphere_sim.world.drives import CommandFollower
from sphere_sim.world.imu_sensor import ImuReading, ImuSensor, SimulatedImuSettings
from sphere_sim.world.plant.contract import Plant
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.pose_sensor import PoseSensor
from sphere_sim.world.settings import PLANTS, SimulatorSettings

_LONGEST_STEP = 10_000_000
"""Longest step between two evaluations of the command [ns]."""


class Simulator:
    """Simulation of a plant on a clock of whole nanoseconds, with ROS and without.

    Parameters
    ----------
    settings : SimulatorSettings, optional
        Plant, start, drives, noise and pose sensor.
    robot : RobotParameters, optional
        The true parameters; defaults to those of Table 1.
    plant : Plant, optional
        Defaults to the one named in `settings`, with default settings of its own.
    imu : SimulatedImuSettings, optional
        Mounting and errors of an IMU; without them there is none.
    """

    def __init__(
        self, settings: SimulatorSettings | None = None, robot: RobotParameters | None = None,
        plant: Plant | None = None, imu: SimulatedImuSettings | None = None,
    ) -> None:
        self.settings = settings = settings or SimulatorSettings()
        """The present settings."""
        robot = robot or RobotParameters()
        start = as_state(settings.initial_state)
        self.plant = make_plant(settings.plant, robot, start) if plant is None else plant
        PLANTS.check(self.plant, plant)
        self.follower = CommandFollower(
            robot.max_rotor_speed, robot.max_rotor_acceleration, settings.command_timeout
        )
        self._noise_period = round(settings.noise_period * NANOSECONDS)
        self._process = np.random.default_rng([settings.seed, 0])
        self._sensor = PoseSensor(settings)
        self.fit_imu(imu)
        self.speed_reference: Vector = np.zeros(INPUT_SIZE)
        """Reference of the rotor speeds [rad/s], shape (2,); the rotors may lag behind it."""
        self.now = 0
        """Simulated time [ns]."""
        self._sample()

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.now / NANOSECONDS

    @property
    def touches(self) -> int:
        """How many separate contacts with walls there have been."""
        return self.plant.contact.touches

    def change(self, settings: SimulatorSettings) -> None:
        """Take over the settings that may change while running (noise, sensor)."""
        self.settings = settings
        self._sensor.change(settings)

    def fit_imu(self, imu: SimulatedImuSettings | None) -> None:
        """Fit an IMU with these settings from now on, or take it away."""
        self.imu = None if imu is None else ImuSensor(imu, self.settings.seed)
        self._sensors: list[PoseSensor | ImuSensor] = [self._sensor]
        self._sensors += [] if self.imu is None else [self.imu]

    def reset(self) -> None:
        """Put the sphere at rest at its start; time and noise continue."""
        self.follower.reset()
        self.speed_reference = np.zeros(INPUT_SIZE)
        self.plant.reset(as_state(self.settings.initial_state))
        if self.imu is not None:
            self.imu.reset()

    def advance_to(self, then: int) -> None:
        """Advance the simulation to `then` [ns]."""
        while self.now < then:
            noise = (self.now // self._noise_period + 1) * self._noise_period
            grid = (self.now // _LONGEST_STEP + 1) * _LONGEST_STEP
            stop = min(then, noise, grid)
            for sensor in self._sensors:
                if sensor.is_on:
                    stop = min(stop, sensor.next_instant(self.now))
            knots = self.follower.knots_between(self.time, stop / NANOSECONDS)
            if knots:
                stop = min(stop, max(self.now + 1, round(knots[0] * NANOSECONDS)))
            duration = (stop - self.now) / NANOSECONDS
            target = self.follower.speeds_after(self.speed_reference, self.time, duration)
            self.plant.advance(target, duration)
            self.speed_reference = target
            self.now = stop
            if stop == noise and self.settings.process_noise > 0.0:
                self._disturb()
            self._sample()

    def poses(self) -> list[tuple[int, Vector]]:
        """Return stamps [ns] and poses, shape (6,), that the sensor has delivered by now.

        Each is returned once. A plain sensor measures at each call.
        """
        if self.settings.is_sensor_plain:
            self._sensor.sample(self.now, self.plant)
        return self._sensor.delivered(self.now)

    def imu_readings(self) -> list[ImuReading]:
        """Return the readings that the IMU has delivered by now, each once."""
        return [] if self.imu is None else self.imu.delivered(self.now)

    def measured_state(self) -> Vector:
        """Return the present state, shape (6,), with new measurement noise at each call."""
        return self._sensor.measured(self.plant.state)

    def _sample(self) -> None:
        for sensor in self._sensors:
            if sensor.is_due(self.now):
                sensor.sample(self.now, self.plant)

    def _disturb(self) -> None:
        """Add the disturbance W(k) of Eq. (43) and normalise the quaternion."""
        state = self.plant.state + self.settings.process_noise * self._process.normal(size=6)
        state[QUATERNION] /= np.linalg.norm(state[QUATERNION])
        self.plant.displace(state)
