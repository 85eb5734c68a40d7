# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Construction of plants by name."""

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.plant.rolling_plant import RollingPlant
from sphere_sim.world.settings import PLANTS
from sphere_sim.world.walls import Walls

Plant = RollingPlant | RigidBodyPlant
"""Rolling sphere whose rotors follow a speed reference that ramps over each step."""


def make_plant(
    name: str, robot: RobotParameters, state: Vector, settings: RigidBodySettings | None = None,
    disturbances: DisturbanceSettings | None = None, walls: Walls | None = None,
) -> Plant:
    """Return a new plant: ``rolling``, the ideal one, or ``rigid_body``, with contact and drives.

    `robot` has the true parameters; the sphere and its rotors start at rest at `state`, shape
    (6,). `settings` are those of ``rigid_body``, by default the robot's own. Without
    `disturbances` the floor is level and nothing brakes, and without `walls` it has no end.

    Raises
    ------
    InvalidParameterError, MissingEngineError
        If there is no plant of that name, or ``rigid_body`` is chosen without MuJoCo.
    """
    if name == "rolling":
        return RollingPlant(robot, state, disturbances, walls)
    if name == "rigid_body":
        return RigidBodyPlant(robot, state, settings, disturbances, walls)
    raise InvalidParameterError("plant", name, " or ".join(PLANTS))
