# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Construction of plants by name."""

from typing import Any, cast

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.checked import CheckedPlant
from sphere_sim.world.plant.contract import Plant, PlantSettings
from sphere_sim.world.settings import PLANTS
from sphere_sim.world.walls import Walls


def settings_class(name: str) -> type[PlantSettings]:
    """Return the class of the settings that a plant of the table has of its own.

    `InvalidParameterError` is raised if the plant cannot be loaded, or its `Settings` are none.
    """
    found: type[PlantSettings] = getattr(PLANTS.load(name), "Settings", PlantSettings)
    if not (isinstance(found, type) and issubclass(found, PlantSettings)):
        raise InvalidParameterError("plant", name, "a class whose Settings extend PlantSettings")
    return found


def make_plant(
    name: str, robot: RobotParameters, state: Vector, settings: PlantSettings | None = None,
    disturbances: DisturbanceSettings | None = None, walls: Walls | None = None,
) -> Plant:
    """Return a new plant by its name in the table `PLANTS`.

    `robot` has the true parameters; the sphere and its rotors start at rest at `state`, shape
    (6,). `settings` are those of the plant, by default the robot's own. Without `disturbances` the
    floor is level and nothing brakes, and without `walls` it has no end.

    Raises
    ------
    InvalidParameterError, MissingEngineError, PlantError
        If there is no plant of that name or it cannot be loaded, ``rigid_body`` is chosen without
        MuJoCo, or a plant of another package cannot be made.
    """
    kind, own = PLANTS.load(name), settings_class(name)
    arguments: dict[str, Any] = {
        "disturbances": disturbances or DisturbanceSettings(), "walls": walls,
    }
    if own is not PlantSettings:
        arguments["settings"] = (own() if settings is None else settings).for_robot(robot)
    if name in PLANTS.own:
        plant: Plant = kind(robot, state, **arguments)
        return plant
    return cast(Plant, CheckedPlant(name, lambda: kind(robot, state, **arguments)))
