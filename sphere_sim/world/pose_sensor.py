# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulated sensor of poses, with noise, latency and drop-outs."""

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_nmpc.quantities import NANOSECONDS
from sphere_sim.world.plant.contract import Plant
from sphere_sim.world.sampled_sensor import SampledSensor
from sphere_sim.world.settings import SimulatorSettings


class PoseSensor(SampledSensor[tuple[int, Vector]]):
    """Sensor that measures poses; a reading is the stamp [ns] and the state, shape (6,).

    The measurements depend on the seed and the settings alone, not on the times at which poses are
    read, unless the sensor is plain: it then measures at each of these, and is off otherwise.
    """

    def __init__(self, settings: SimulatorSettings) -> None:
        super().__init__(settings.sensor_rate or settings.pose_rate, settings.sensor_latency)
        # Streams 0 and 2 belong to the process noise and to the plant's parameters.
        self._noise = np.random.default_rng([settings.seed, 1])
        self._dropouts = np.random.default_rng([settings.seed, 3])
        self.change(settings)

    def change(self, settings: SimulatorSettings) -> None:
        """Take over settings that may change while running: noise, latency, drop-outs."""
        self._settings = settings
        self.is_on = not settings.is_sensor_plain
        self.latency = round(settings.sensor_latency * NANOSECONDS)

    def sample(self, now: int, plant: Plant) -> None:
        """Measure the pose of the plant at this instant."""
        # With noise for lost poses too, so that a loss does not change the noise of the others.
        measured = self.measured(plant.state)
        if self._dropouts.random() >= self._settings.sensor_dropout:
            self.deliver(now, (now, measured))

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
