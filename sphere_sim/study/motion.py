# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motion whose lower bound and best known time a run is compared with."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from sphere_nmpc.model.drift import NO_DRIFT, Drift, imbalance_of_offset, slope_torque
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, QUATERNION, Vector
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.lower_bound import lower_bound
from sphere_sim.study.record import RunRecord
from sphere_sim.world.disturbances import DisturbanceSettings

AT_REST = 0.5
"""Error of the rotor speeds below which the sphere is at rest [rad/s]; it then rolls at less than
3 mm/s, and the rotors end that within 2 ms."""


@dataclass(frozen=True, eq=False)
class Motion:
    """States at start and goal of a motion; it ends at rest, with the momentum in the rotors.

    `speeds` are those of the rotors at the start [rad/s], shape (2,), and `drift` has the momentum
    at the start, slope and imbalance.
    """

    start: Vector
    goal: Vector
    speeds: Vector = field(default_factory=lambda: np.zeros(INPUT_SIZE))
    drift: Drift = NO_DRIFT

    def lower_bound(self, robot: RobotParameters) -> float:
        """Return a time [s] in which no motion is possible; nan where no bound is known.

        `sphere_sim.study.lower_bound` has the bound, which holds without drift and from rest.
        """
        if self.speeds.any() or not self.drift.is_zero:
            return math.nan
        return lower_bound(self.start, self.goal, robot)

    @property
    def starts_at_rest(self) -> bool:
        """Whether the sphere is at rest at the start, but for what the rotors end at once."""
        excess = self.drift.in_body(self.start[QUATERNION]) - [*self.speeds, 0.0]
        return bool(np.max(np.abs(excess)) < AT_REST)


def drift_of(
    settings: DisturbanceSettings, robot: RobotParameters, momentum: Vector = NO_DRIFT.momentum
) -> Drift:
    """Return the drift of a robot with a momentum h [rad/s; world frame], shape (3,)."""
    return Drift(
        momentum,
        slope_torque(robot, settings.slope, settings.slope_direction),
        imbalance_of_offset(robot, np.array(settings.mass_offset)),
    )


def motion_of(
    scenario: Scenario, record: RunRecord, robot: RobotParameters, settings: DisturbanceSettings
) -> Motion:
    """Return the motion of a run: from its push on if there was one, otherwise from its start.

    The robot has no errors of its parameters; the scenario's disturbances replace the settings.
    """
    settings = replace(settings, **scenario.disturbances)
    drift = drift_of(settings, robot)
    if not record.at_push.size:
        return Motion(scenario.start, scenario.goal, drift=drift)
    state, speeds, momentum = np.split(record.at_push, (6, 8))
    drift = replace(drift, momentum=momentum / robot.rotor_axial_inertia)
    return Motion(state, scenario.goal, speeds, drift)
