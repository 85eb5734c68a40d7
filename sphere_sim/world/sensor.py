# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The pose sensor of the simulated world: its rate, noise, latency and drop-outs."""

from collections import deque

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_sim.world.settings import SimulatorSettings

NANOSECONDS = 1_000_000_000


class PoseSensor:
    """See poses at their time and hand them over late, or not at all.

    Times are simulated time [ns]. With a rate of its own what it sees depends on the seed and the
    settings alone, not on who asks when.

    Parameters
    ----------
    settings : SimulatorSettings
        Rate, noise, latency, drop-outs and seed.
    """

    def __init__(self, settings: SimulatorSettings) -> None:
        self._settings = settings
        rate = settings.sensor_rate
        self._period = round(NANOSECONDS / rate) if rate > 0.0 else 0
        # Streams 0 and 2 belong to the process noise and to the plant's parameters.
        self._noise = np.random.default_rng([settings.seed, 1])
        self._losses = np.random.default_rng([settings.seed, 3])
        self._under_way: deque[tuple[int, int, Vector]] = deque()

    def change(self, settings: SimulatorSettings) -> None:
        """Take over what may change while running: noise, latency, drop-outs."""
        self._settings = settings

    def next_instant(self, now: int) -> int | None:
        """Return when it looks next, after `now`; None where it looks whenever it is asked."""
        return (now // self._period + 1) * self._period if self._period else None

    def is_due(self, now: int) -> bool:
        """Return whether a sensor with a rate of its own looks at this instant."""
        return self._period > 0 and now % self._period == 0

    def look(self, now: int, state: Vector) -> None:
        """See the true state, shape (6,), of this instant."""
        # Drawn for lost poses too, so that a loss changes none of the others.
        measured = self.measured(state)
        if self._losses.random() >= self._settings.sensor_dropout:
            latency = round(self._settings.sensor_latency * NANOSECONDS)
            self._under_way.append((now + latency, now, measured))

    def delivered(self, now: int) -> list[tuple[int, Vector]]:
        """Return stamps and poses that have come through by now, each once, in order."""
        arrived = [(stamp, pose) for due, stamp, pose in self._under_way if due <= now]
        self._under_way = deque(entry for entry in self._under_way if entry[0] > now)
        return arrived

    def measured(self, state: Vector) -> Vector:
        """Return the state, shape (6,), with fresh noise."""
        settings, seen = self._settings, state.copy()
        if settings.position_noise > 0.0:
            seen[POSITION] += settings.position_noise * self._noise.normal(size=2)
        if settings.orientation_noise > 0.0:
            # To first order a rotation by the vector 2 e; the norm is restored below.
            half = 0.5 * settings.orientation_noise * self._noise.normal(size=3)
            turn = rotation.product(seen[QUATERNION], np.concatenate(([1.0], half)))
            seen[QUATERNION] = turn / np.linalg.norm(turn)
        return seen
