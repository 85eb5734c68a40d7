# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random errors of the robot's parameters, pushes, slopes and centres of mass of scenarios."""

from dataclasses import dataclass, fields, replace

import numpy as np

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.world.disturbances import Push

LIMITS = ("max_rotor_speed", "max_rotor_acceleration", "max_rotor_torque")
"""Limits of the drives, which are known exactly: the drives enforce them."""

EARLIEST_PUSH, LATEST_PUSH = 0.5, 3.0
"""Limits of the times of pushes [s]: most are while the sphere is under way, some at its goal."""
_ATTEMPTS = 1000
"""Largest number of attempts; at 20 % about one in eleven gives an impossible robot."""


def perturbed(
    robot: RobotParameters, fraction: float, rng: np.random.Generator
) -> RobotParameters:
    """Return a robot with each physical parameter times 1 + fraction * U(-1, 1).

    `fraction` is from 0 (the same robot) to below 1. Parameters that no robot can have, such as
    too large an inertia for the shell's mass and radius, are all drawn again.
    `InvalidParameterError` is raised if the fraction is not in its range, or no possible robot is
    found.
    """
    if not 0.0 <= fraction < 1.0:
        raise InvalidParameterError("perturbation", fraction, "a fraction from 0 to below 1")
    if fraction == 0.0:
        return robot
    names = [field.name for field in fields(robot) if field.name not in LIMITS]
    for _ in range(_ATTEMPTS):
        factors = 1.0 + fraction * rng.uniform(-1.0, 1.0, size=len(names))
        changes = {
            name: getattr(robot, name) * float(factor)
            for name, factor in zip(names, factors, strict=True)
        }
        try:
            return replace(robot, **changes)
        except InvalidParameterError:
            continue
    raise InvalidParameterError("perturbation", fraction, "one that leaves the robot possible")


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
