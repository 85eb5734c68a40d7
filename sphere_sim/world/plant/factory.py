# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Construction of plants by name."""

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.contract import Plant
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.plant.rolling_plant import RollingPlant
from sphere_sim.world.settings import PLANTS


def make_plant(
    name: str,
    robot: RobotParameters,
    state: Vector,
    settings: RigidBodySettings | None = None,
    disturbances: DisturbanceSettings | None = None,
) -> Plant:
    """Return a new plant: ``rolling``, the ideal one, or ``rigid_body``, with contact and drives.

    Parameters
    ----------
    name : str
        ``rolling`` or ``rigid_body``.
    robot : RobotParameters
        True parameters of the robot; those of the controller may differ.
    state : ndarray, shape (6,)
        Initial state; the sphere and its rotors start at rest.
    settings : RigidBodySettings, optional
        Settings of ``rigid_body``; ``rolling`` has none.
    disturbances : DisturbanceSettings, optional
        Slope, offset of the centre of mass and friction; none by default.

    Raises
    ------
    InvalidParameterError
        If there is no plant of that name.
    MissingEngineError
        If ``rigid_body`` is chosen and MuJoCo is not installed.
    """
    if name == "rolling":
        return RollingPlant(robot, state, disturbances)
    if name == "rigid_body":
        return RigidBodyPlant(robot, state, settings, disturbances)
    raise InvalidParameterError("plant", name, " or ".join(PLANTS))
