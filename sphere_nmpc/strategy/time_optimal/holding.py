# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rest at the goal, with corrections of small errors by rolling."""

import dataclasses

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, nearer_sign, state_error
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.paper import PaperStrategy
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings


class RestAtGoal:
    """Plans of a sphere that rests at the goal.

    Parameters
    ----------
    settings : ControllerSettings
        Input weight and cap on iterations of the corrections.
    robot : RobotParameters
        Limits of the drives.
    tuning : TimeOptimalSettings
        Least noise that is corrected, horizon and weight of the corrections.
    """

    def __init__(
        self, settings: ControllerSettings, robot: RobotParameters, tuning: TimeOptimalSettings
    ) -> None:
        self._acceleration = robot.max_rotor_acceleration
        self._tuning = tuning
        self._corrections = PaperStrategy(
            self._for_corrections(settings), robot, tuning.correction_weight
        )

    def change(self, settings: ControllerSettings) -> None:
        """Use other weights and another cap on iterations; the warm start is kept."""
        self._corrections.change(self._for_corrections(settings))

    def reset(self) -> None:
        """Forget the warm start."""
        self._corrections.reset()

    def plan(self, situation: Situation) -> Plan:
        """Return a ramp to rest, or a correction of what rolling itself can correct."""
        error = state_error(situation.state, situation.goal)
        tuning = self._tuning
        if error > tuning.least_dead_band or situation.noise > tuning.correction_noise:
            goal = nearer_sign(situation.goal, situation.state)
            plan = self._corrections.plan(dataclasses.replace(situation, goal=goal))
            return dataclasses.replace(plan, status=PlanStatus.HOLDING)
        message = f"at the goal, {error:.1e} off"
        return ramp_to_rest(situation, self._acceleration, PlanStatus.HOLDING, message)

    def _for_corrections(self, settings: ControllerSettings) -> ControllerSettings:
        return dataclasses.replace(settings, horizon=self._tuning.correction_horizon)


def ramp_to_rest(
    situation: Situation, acceleration: float, status: PlanStatus, message: str
) -> Plan:
    """Return a plan that brings the rotors to rest with `acceleration` [rad/s^2]."""
    hold = FirstOrderHold.ramp_to_rest(situation.time, situation.input_in_force, acceleration)
    states: Vector = situation.state[None, :]
    return Plan(status, hold, states, message=message)
