# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulated IMU in the shell, with its errors, read together with the encoders of the rotors."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_nmpc.quantities import NANOSECONDS, quantity
from sphere_sim.world.plant.contract import Plant
from sphere_sim.world.sampled_sensor import SampledSensor

_RATE, _FORCE = slice(0, 3), slice(3, 6)


@dataclass(frozen=True)
class SimulatedImuSettings(ImuSettings):
    """Settings of the simulated IMU: those of any, and when it is read."""

    rate: float = quantity(
        100.0, "Hz", "Rate of readings of IMU and encoders", minimum=10.0, maximum=2000.0
    )
    latency: float = quantity(
        0.0, "s", "Delay of readings; their stamp is the time of measurement", minimum=0.0,
        maximum=10.0,
    )

    @property
    def deviations(self) -> Vector:
        """Standard deviations of the white noise of a reading [rad/s, m/s^2], shape (2,)."""
        densities = np.array([self.gyro_noise, self.accelerometer_noise])
        return densities * math.sqrt(self.rate)


class ImuReading(NamedTuple):
    """What IMU and encoders measured at an instant; the encoders are exact."""

    stamp: int
    """Simulated time [ns], below 0 before the start."""
    rate: Vector
    """Angular velocity [rad/s; axes of the sensor], shape (3,)."""
    force: Vector
    """Specific force [m/s^2; axes of the sensor], shape (3,)."""
    angles: Vector
    """Angles of the rotors [rad], shape (2,)."""
    speeds: Vector
    """Speeds of the rotors relative to the shell [rad/s], shape (2,)."""
    torques: Vector
    """Motor torques [N m], shape (2,)."""


class ImuSensor(SampledSensor[ImuReading]):
    """Simulated IMU; its errors depend on the settings and the seed alone."""

    def __init__(self, settings: SimulatedImuSettings, seed: int) -> None:
        super().__init__(settings.rate, settings.latency)
        self.settings = settings
        self._seed = seed
        # Streams 0 to 6 belong to the simulator and to studies.
        self._random = np.random.default_rng([seed, 7])
        draw = self._random.normal
        biases = np.repeat([settings.gyro_bias, settings.accelerometer_bias], 3)
        self._bias = self._start_bias = biases * draw(size=6)
        scales = settings.gyro_scale, settings.accelerometer_scale
        by: Vector = np.zeros((6, 6))
        for part, scale in zip((_RATE, _FORCE), scales, strict=True):
            by[part, part] = np.eye(3) + settings.cross_axis * draw(size=(3, 3))
            by[part, part][np.diag_indices(3)] = 1.0 + scale * draw(size=3)
        by[_RATE, _FORCE] = settings.g_sensitivity * draw(size=(3, 3))
        self._by = by
        """Readings without bias and noise by rate and force as they are, shape (6, 6)."""
        self._position = np.array(settings.position) + settings.position_deviation * draw(size=3)
        turned = rotation.exponential(settings.orientation_deviation * draw(size=3))
        self._turn = rotation.matrix(turned) @ settings.turn
        self._before: tuple[Vector, Vector, Vector] | None = None
        """Velocity of its place [m/s; world frame], orientation and body rate [rad/s] at the
        reading before."""
        walks = np.repeat([settings.gyro_bias_walk, settings.accelerometer_bias_walk], 3)
        self._step = walks * math.sqrt(self.period / NANOSECONDS)

    def reset(self) -> None:
        """Forget how the plant has moved, as it is put elsewhere."""
        self._before = None

    def sample(self, now: int, plant: Plant) -> None:
        """Read the plant at this instant."""
        drawn = self._random.normal(size=(2, 6))
        self.deliver(now, self._reading(now, self._sensed(plant), self._bias, drawn[0], plant))
        self._bias = self._bias + self._step * drawn[1]

    def _sensed(self, plant: Plant) -> Vector:
        """Return mean rate and mean specific force without errors, shape (6,).

        They follow from the changes of orientation and velocity since the reading before, so that
        a push has its impulse, and what is faster than the readings, as the vibrations of a
        contact, is averaged as by the filter of a device.
        """
        rate, q = plant.body_rate, plant.state[QUATERNION]
        velocity = plant.velocity + rotation.matrix(q) @ np.cross(rate, self._position)
        before, q_before, rate_before = self._before or (velocity, q, rate)
        self._before = velocity, q, rate
        step = self.period / NANOSECONDS
        mean = rate
        if q is not q_before:
            turned = rotation.logarithm(rotation.product(rotation.conjugate(q_before), q))
            # A rotation is more than the integral of a rate whose direction changes.
            mean = turned / step - step / 12.0 * np.cross(rate_before, rate)
        middle = q + rotation.nearer_sign(q_before, q)
        middle = rotation.matrix(middle / np.linalg.norm(middle))
        felt = (velocity - before) / step - plant.gravity
        return np.concatenate((mean @ self._turn, felt @ middle @ self._turn))

    def at_rest(self, duration: float, plant: Plant) -> list[ImuReading]:
        """Return the readings of the last `duration` [s] before time 0, in order.

        The plant has to be at its start, where the sphere has been at rest before: all readings
        are those of what it measures there, with errors of their own; on a slope, of a sphere that
        is held.
        """
        number = math.ceil(round(duration * NANOSECONDS) / self.period)
        # Backwards, so that the last readings are the same for any duration.
        drawn = np.random.default_rng([self._seed, 7, 1]).normal(size=(number, 2, 6))
        biases = self._start_bias - self._step * np.cumsum(drawn[:, 1], axis=0)
        true = self._sensed(plant)
        return [
            self._reading(-self.period * (i + 1), true, biases[i], drawn[i, 0], plant)
            for i in reversed(range(number))
        ]

    def _reading(
        self, stamp: int, true: Vector, bias: Vector, drawn: Vector, plant: Plant
    ) -> ImuReading:
        """Return what is measured of rate and force `true`, shape (6,), with noise as `drawn`."""
        settings = self.settings
        found = self._by @ true + bias + np.repeat(settings.deviations, 3) * drawn
        most = np.repeat([settings.gyro_range, settings.accelerometer_range], 3)
        found = np.clip(found, -most, most)
        return ImuReading(
            stamp, found[_RATE], found[_FORCE], plant.rotor_angles, plant.rotor_speeds,
            plant.rotor_torques,
        )
