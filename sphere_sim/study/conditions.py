# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Conditions of a study: all settings of a run except its scenario."""

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantity import quantity, validate
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.settings import SimulatorSettings

_SCENARIO_SETTINGS = ("initial_state", "seed")


@dataclass(frozen=True)
class StudyConditions:
    """Settings that all runs of a study share.

    Attributes
    ----------
    controller : ControllerSettings
        Settings of the controller, including its strategy.
    simulator : SimulatorSettings
        Settings of the simulator; start and seed come from the scenario.
    robot : RobotParameters
        Nominal parameters of the robot, which the controller has.
    rigid_body : RigidBodySettings
        Settings of the plant ``rigid_body``.
    disturbances : DisturbanceSettings
        Slope, offset of the centre of mass and friction in both plants.

    Raises
    ------
    InvalidParameterError
        If a value is not in its range.
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
    rigid_body: RigidBodySettings = field(default_factory=RigidBodySettings)
    disturbances: DisturbanceSettings = field(default_factory=DisturbanceSettings)

    def __post_init__(self) -> None:
        validate(self)

    def with_settings(self, assignments: Iterable[tuple[str, str]]) -> "StudyConditions":
        """Return the conditions with other values of some settings.

        Parameters
        ----------
        assignments : iterable of (str, str)
            Names and values as text. A name that occurs in only one of controller, simulator,
            robot, rigid_body and disturbances needs no prefix such as in
            ``simulator.sample_period``.

        Raises
        ------
        InvalidParameterError
            If there is no such setting, the name is ambiguous, or the value is not in its range.
        """
        conditions = self
        for name, text in assignments:
            group, _, setting = name.rpartition(".")
            groups = [group] if group else _groups_with(setting)
            if len(groups) > 1:
                raise InvalidParameterError(
                    name, text, " or ".join(f"{one}.{setting}" for one in groups)
                )
            known = _defaults(groups[0]) if groups else {}
            if setting not in known:
                raise InvalidParameterError(name, text, "the name of a setting")
            if setting in _SCENARIO_SETTINGS:
                raise InvalidParameterError(name, text, "to be left to the scenarios")
            settings = getattr(conditions, groups[0])
            value = _parse(name, text, known[setting])
            changed = dataclasses.replace(settings, **{setting: value})
            conditions = dataclasses.replace(conditions, **{groups[0]: changed})
        return conditions


def _groups_with(setting: str) -> list[str]:
    return [group for group in _GROUPS if setting in _defaults(group)]


def _defaults(group: str) -> dict[str, Any]:
    settings = _GROUPS.get(group)
    return {} if settings is None else {f.name: f.default for f in dataclasses.fields(settings)}


_GROUPS: dict[str, Any] = {
    "controller": ControllerSettings,
    "simulator": SimulatorSettings,
    "robot": RobotParameters,
    "rigid_body": RigidBodySettings,
    "disturbances": DisturbanceSettings,
}


def _parse(name: str, text: str, default: Any) -> Any:
    """Convert the text of a setting into the type of its default."""
    try:
        if isinstance(default, bool):
            return {"true": True, "false": False}[text.lower()]
        if isinstance(default, tuple):
            return tuple(float(part) for part in text.split(","))
        return type(default)(text)
    except (KeyError, ValueError):
        kind = "true or false" if isinstance(default, bool) else "a number"
        kind = "a whole number" if type(default) is int else kind
        raise InvalidParameterError(name, text, kind) from None
