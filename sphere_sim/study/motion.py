# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motion whose lower bound and best known time a run is compared with."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from sphere_nmpc.model.disturbance import (
    UNDISTURBED,
    Disturbance,
    imbalance_of_offset,
    in_body,
    is_zero,
    slope_torque,
)
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, MOMENTUM, QUATERNION, Vector, without_momentum
from sphere_sim.scenario.lower_bound import lower_bound
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.record import RunRecord
from sphere_sim.world.disturbances import DisturbanceSettings

AT_REST = 0.5
"""Error of the rotor speeds below which the sphere is at rest [rad/s]; it then rolls at less than
3 mm/s, and the rotors end that within 2 ms."""


@dataclass(frozen=True, eq=False)
class Motion:
    """State at the start, shape (9,), and goal, shape (6,), of a motion.

    It ends at rest, with the momentum in the rotors. `speeds` are those at its start [rad/s].
    `orientation` is what the goal demands of the orientation.
    """

    start: Vector
    goal: Vector
    speeds: Vector = field(default_factory=lambda: np.zeros(INPUT_SIZE))
    disturbance: Disturbance = UNDISTURBED
    orientation: Orientation = Orientation.FULL

    def lower_bound(self, robot: RobotParameters) -> float:
        """Return a time [s] in which no motion is possible; nan where no bound is known.

        `sphere_sim.scenario.lower_bound` has the bound, which holds from rest without momentum.
        """
        if not self.starts_in_model_of_paper or self.orientation is not Orientation.FULL:
            return math.nan
        return lower_bound(self.start, self.goal, robot)

    @property
    def starts_in_model_of_paper(self) -> bool:
        """Whether the rotors are at rest, without momentum, slope and imbalance."""
        return not self.speeds.any() and is_zero(self.start[MOMENTUM], self.disturbance)

    @property
    def starts_at_rest(self) -> bool:
        """Whether the sphere is at rest at the start, but for what the rotors end at once."""
        excess = in_body(self.start[MOMENTUM], self.start[QUATERNION]) - [*self.speeds, 0.0]
        return bool(np.max(np.abs(excess)) < AT_REST)


def disturbance_of(settings: DisturbanceSettings, robot: RobotParameters) -> Disturbance:
    """Return slope and imbalance in the units of the model of a robot."""
    return Disturbance(
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
    disturbance = disturbance_of(settings, robot)
    along = Orientation.FULL if scenario.follows is None else Orientation.ANY
    if not record.at_push.size:
        start = without_momentum(scenario.start)
        return Motion(start, scenario.goal, disturbance=disturbance, orientation=along)
    pose, speeds, momentum = np.split(record.at_push, (6, 8))
    state = np.concatenate((pose, momentum / robot.rotor_axial_inertia))
    return Motion(state, scenario.goal, speeds, disturbance, along)
