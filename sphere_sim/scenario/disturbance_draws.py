# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random pushes, slopes and centres of mass of scenarios."""

from dataclasses import dataclass, replace

import numpy as np

from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.world.push import Push

EARLIEST_PUSH, LATEST_PUSH = 0.5, 3.0
"""Limits of the times of pushes [s]: most are while the sphere is under way, some at its goal."""


@dataclass(frozen=True)
class DisturbanceDraws:
    """What is drawn for each scenario, from its seed; directions are uniform.

    Attributes
    ----------
    push : tuple of float, optional
        Smallest and largest impulse of a push [N s]; without it there is none.
    push_time : float, optional
        Time of the pushes [s]; by default it is drawn.
    slope : float
        Inclination of the floor [rad]; at 0 the scenario keeps its own.
    offset : float
        Distance of the centre of mass from the centre of the sphere [m]; at 0 the same holds.
    """

    push: tuple[float, float] | None = None
    push_time: float | None = None
    slope: float = 0.0
    offset: float = 0.0

    def applied_to(self, scenario: Scenario) -> Scenario:
        """Return the scenario with the disturbances that are drawn for it."""
        # Streams 0 to 3 of the seed belong to the simulator and to the plant's parameters; each
        # draw has its own, so that it does not depend on the others.
        pushes, slopes, offsets = (
            np.random.default_rng([scenario.seed, stream]) for stream in (4, 5, 6)
        )
        disturbances = dict(scenario.disturbances)
        if self.slope:
            disturbances["slope"] = self.slope
            disturbances["slope_direction"] = float(slopes.uniform(-np.pi, np.pi))
        if self.offset:
            direction = offsets.normal(size=3)
            direction *= self.offset / np.linalg.norm(direction)
            for axis, value in zip("xyz", direction.tolist(), strict=True):
                disturbances[f"mass_offset_{axis}"] = value
        push = scenario.push if self.push is None else _push(pushes, self.push, self.push_time)
        return replace(scenario, push=push, disturbances=disturbances)


def _push(
    rng: np.random.Generator, impulses: tuple[float, float], time: float | None
) -> Push:
    bearing, impulse = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*impulses)
    drawn = rng.uniform(EARLIEST_PUSH, LATEST_PUSH)
    return Push(
        float(drawn) if time is None else time,
        (float(impulse * np.cos(bearing)), float(impulse * np.sin(bearing))),
    )
