# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator: a plant with its drives, noise and pose sensor."""

from collections import deque

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, POSITION, QUATERNION, Vector, as_state
from sphere_nmpc.quantity import NANOSECONDS
from sphere_sim.world.drives import CommandFollower
from sphere_sim.world.plant.contract import Plant
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.settings import SimulatorSettings

_LONGEST_STEP = 10_000_000
"""Longest step between two evaluations of the command [ns]."""


class Simulator:
    """Simulation of a plant on a clock of whole nanoseconds, with ROS and without.

    `robot` has the true parameters. The plant is by default the one named in `settings`, with
    default settings of its own.
    """

    def __init__(
        self, settings: SimulatorSettings, robot: RobotParameters, plant: Plant | None = None
    ) -> None:
        self._settings = settings
        start = as_state(settings.initial_state)
        self.plant = make_plant(settings.plant, robot, start) if plant is None else plant
        self.follower = CommandFollower(
            robot.max_rotor_speed, robot.max_rotor_acceleration, settings.command_timeout
        )
        self._noise_period = round(settings.noise_period * NANOSECONDS)
        self._process = np.random.default_rng([settings.seed, 0])
        self._sensor = PoseSensor(settings)
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

    @property
    def settings(self) -> SimulatorSettings:
        """The present settings."""
        return self._settings

    def change(self, settings: SimulatorSettings) -> None:
        """Take over the settings that may change while running (noise, sensor)."""
        self._settings = settings
        self._sensor.change(settings)

    def reset(self) -> None:
        """Put the sphere at rest at its start; time and noise continue."""
        self.follower.reset()
        self.speed_reference = np.zeros(INPUT_SIZE)
        self.plant.reset(as_state(self._settings.initial_state))

    def advance_to(self, then: int) -> None:
        """Advance the simulation to `then` [ns]."""
        while self.now < then:
            noise = (self.now // self._noise_period + 1) * self._noise_period
            grid = (self.now // _LONGEST_STEP + 1) * _LONGEST_STEP
            sample = self._sensor.next_instant(self.now)
            stop = min(then, noise, grid if sample is None else min(grid, sample))
            knots = self.follower.knots_between(self.time, stop / NANOSECONDS)
            if knots:
                stop = min(stop, max(self.now + 1, round(knots[0] * NANOSECONDS)))
            duration = (stop - self.now) / NANOSECONDS
            target = self.follower.speeds_after(self.speed_reference, self.time, duration)
            self.plant.advance(target, duration)
            self.speed_reference = target
            self.now = stop
            if stop == noise and self._settings.process_noise > 0.0:
                self._disturb()
            self._sample()

    def poses(self) -> list[tuple[int, Vector]]:
        """Return stamps [ns] and poses, shape (6,), that the sensor has delivered by now.

        Each is returned once. A plain sensor measures at each call.
        """
        if self._settings.is_sensor_plain:
            self._sensor.sample(self.now, self.plant.state)
        return self._sensor.delivered(self.now)

    def measured_state(self) -> Vector:
        """Return the present state, shape (6,), with new measurement noise at each call."""
        return self._sensor.measured(self.plant.state)

    def _sample(self) -> None:
        if self._sensor.is_due(self.now):
            self._sensor.sample(self.now, self.plant.state)

    def _disturb(self) -> None:
        """Add the disturbance W(k) of Eq. (43) and normalise the quaternion."""
        state = self.plant.state + self._settings.process_noise * self._process.normal(size=6)
        state[QUATERNION] /= np.linalg.norm(state[QUATERNION])
        self.plant.displace(state)


class PoseSensor:
    """Sensor that measures poses at sampling instants and delivers them after a latency.

    Times are simulated time [ns]. The measurements depend on the seed and the settings alone, not
    on the times at which poses are read, unless the sensor is plain: it measures at each of these.
    """

    def __init__(self, settings: SimulatorSettings) -> None:
        self._settings = settings
        self._period = round(NANOSECONDS / (settings.sensor_rate or settings.pose_rate))
        # Streams 0 and 2 belong to the process noise and to the plant's parameters.
        self._noise = np.random.default_rng([settings.seed, 1])
        self._dropouts = np.random.default_rng([settings.seed, 3])
        self._pending: deque[tuple[int, int, Vector]] = deque()

    def change(self, settings: SimulatorSettings) -> None:
        """Take over settings that may change while running: noise, latency, drop-outs."""
        self._settings = settings

    def next_instant(self, now: int) -> int | None:
        """Return the first sampling instant after `now`; None for a plain sensor."""
        if self._settings.is_sensor_plain:
            return None
        return (now // self._period + 1) * self._period

    def is_due(self, now: int) -> bool:
        """Return whether `now` is a sampling instant of a sensor that is not plain."""
        return not self._settings.is_sensor_plain and now % self._period == 0

    def sample(self, now: int, state: Vector) -> None:
        """Measure the true state, shape (6,), at this instant."""
        # With noise for lost poses too, so that a loss does not change the noise of the others.
        measured = self.measured(state)
        if self._dropouts.random() >= self._settings.sensor_dropout:
            latency = round(self._settings.sensor_latency * NANOSECONDS)
            self._pending.append((now + latency, now, measured))

    def delivered(self, now: int) -> list[tuple[int, Vector]]:
        """Return stamps and poses that are due by now, each once, in order."""
        due_poses = [(stamp, pose) for due, stamp, pose in self._pending if due <= now]
        self._pending = deque(entry for entry in self._pending if entry[0] > now)
        return due_poses

    def measured(self, state: Vector) -> Vector:
        """Return the state, shape (6,), with new noise."""
        settings, measured = self._settings, state.copy()
        if settings.position_noise > 0.0:
            measured[POSITION] += settings.position_noise * self._noise.normal(size=2)
        if settings.orientation_noise > 0.0:
            # To first order a rotation by the vector 2 e; the norm is restored below.
            half = 0.5 * settings.orientation_noise * self._noise.normal(size=3)
            turn = rotation.product(measured[QUATERNION], np.concatenate(([1.0], half)))
            measured[QUATERNION] = turn / np.linalg.norm(turn)
        return measured
