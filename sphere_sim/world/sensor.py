# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Pose sensor of the simulation: its rate, noise, latency and drop-outs."""

from collections import deque

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_nmpc.quantity import NANOSECONDS
from sphere_sim.world.settings import SimulatorSettings


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
