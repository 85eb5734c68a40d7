# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Conditions of a study: all settings of a run except its scenario."""

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.estimation.odometry_settings import OdometrySettings
from sphere_nmpc.floor.settings import FloorSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantities import parsed, quantities, quantity, validate
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.imu_sensor import SimulatedImuSettings
from sphere_sim.world.plant.contract import PlantSettings
from sphere_sim.world.plant.factory import settings_class
from sphere_sim.world.settings import PLANTS, SimulatorSettings

_SCENARIO_SETTINGS = ("initial_state", "seed")
OF_NODES = {
    "simulator": ("pose_rate", "command_timeout"), "odometry": ("fix_memory",),
}
"""Settings that have no effect on a run of a study, by kind."""


@dataclass(frozen=True)
class StudyConditions:
    """Settings that all runs of a study share.

    The controller has the nominal parameters of the robot and gets its units; start and seed of
    the simulator come from the scenario. `InvalidParameterError` is raised for a value that is not
    in its range.
    """

    duration: float = quantity(30.0, "s", "Length of a run", minimum=0.01, maximum=1e5)
    perturbation: float = quantity(
        0.0, "%", "Largest error of each of the robot's parameters", minimum=0.0, maximum=90.0
    )
    latency: float = quantity(
        0.0, "s", "Age of the newest pose at a sampling instant", minimum=0.0, maximum=10.0
    )
    controller: ControllerSettings = field(default_factory=ControllerSettings)
    simulator: SimulatorSettings = field(default_factory=SimulatorSettings)
    robot: RobotParameters = field(default_factory=RobotParameters)
    plants: Mapping[str, PlantSettings] = field(default_factory=dict, hash=False)
    """Settings that plants have of their own, by plant; those of others are their defaults."""
    disturbances: DisturbanceSettings = field(default_factory=DisturbanceSettings)
    floor: FloorSettings = field(default_factory=FloorSettings)
    imu: SimulatedImuSettings = field(default_factory=SimulatedImuSettings)
    odometry: OdometrySettings = field(default_factory=OdometrySettings)

    def __post_init__(self) -> None:
        validate(self)
        object.__setattr__(self, "controller", self.controller.of(self.robot))

    @property
    def of_plant(self) -> PlantSettings:
        """Settings that the plant of the runs has of its own."""
        name = self.simulator.plant
        return self.plants.get(name) or settings_class(name)()

    def with_settings(self, assignments: Iterable[tuple[str, str]]) -> "StudyConditions":
        """Return the conditions with other values of some settings.

        Names and values are text, in any order. A name that occurs in only one of controller,
        simulator, robot, rigid_body, disturbances, floor, imu and odometry needs no prefix such as
        in ``controller.horizon``; plants of other packages have their name as the prefix.

        `InvalidParameterError` is raised if there is no such setting or no study reads it, one is
        given twice, or the values are not in their ranges.
        """
        given: dict[str, dict[str, str]] = {}
        for name, text in assignments:
            group, setting = _found(name, text)
            texts = given.setdefault(group, {})
            if setting in texts:
                raise InvalidParameterError(
                    f"{group}.{setting}", [texts[setting], text], "one value"
                )
            texts[setting] = text
        changed, plants = {}, dict(self.plants)
        for group, texts in given.items():
            known = _defaults(group)
            values = {name: parsed(name, text, known[name]) for name, text in texts.items()}
            # All at once, as some are valid only together.
            if group in _GROUPS:
                changed[group] = dataclasses.replace(getattr(self, group), **values)
            else:
                plants[group] = dataclasses.replace(plants.get(group) or _kind(group)(), **values)
        return dataclasses.replace(self, plants=plants, **changed)


_GROUPS: dict[str, Any] = {
    one.name: one.default_factory for one in dataclasses.fields(StudyConditions)
    if one.default_factory is not dataclasses.MISSING and one.name != "plants"
}
"""Classes of the settings of all runs, by kind."""


def _found(name: str, text: str) -> tuple[str, str]:
    """Return kind and name of a setting that a study reads."""
    prefix, _, setting = name.rpartition(".")
    known = [g for g in (*_GROUPS, *sorted({*PLANTS.own, prefix} & {*PLANTS})) if _defaults(g)]
    groups = [g for g in known if prefix in ("", g) and setting in _defaults(g)]
    if not groups:
        raise InvalidParameterError(name, text, f"a setting of {', '.join(known)}")
    if setting in _SCENARIO_SETTINGS:
        raise InvalidParameterError(name, text, "to be left to the scenarios")
    for group in groups:
        if setting not in OF_NODES.get(group, ()):
            return group, setting
    others = {*OF_NODES[groups[0]], *_SCENARIO_SETTINGS}
    read = ", ".join(other for other in _defaults(groups[0]) if other not in others)
    raise InvalidParameterError(
        name, text, f"a setting of the {groups[0]} that a study reads: {read}"
    )


def _kind(group: str) -> Any:
    """Return the class of a kind of settings: one of all runs, or of the plant of that name."""
    return _GROUPS.get(group) or settings_class(group)


def _defaults(group: str) -> dict[str, Any]:
    return {name: getattr(_kind(group), name) for name in quantities(_kind(group))}
